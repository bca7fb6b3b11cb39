"""Feet under the bed of a machine, and the shoes of each carriage on its guide.

Neither is needed to identify or compensate a machine. What a fitter changes at the machine, a shim under a rail or the
height of a foot, moves the tool by an amount that depends on them (`twin.workpiece.action_fields`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from twin.arrays import Array
from twin.errors import ModelError
from twin.machine.error_model import Ranges
from twin.machine.kinematic_chain import AXES

FEWEST_FEET = 4
_FLAT = 1e-6  # of the largest singular value: feet on one line or on two crossing lines show no twist


@dataclass(frozen=True)
class Guide:
    """Guide of an axis. `shoes_mm` is the distance along the axis between the first and the last shoe of the carriage.

    `centre_mm` is the middle of the shoes, as a vector from the reference point of the ram, with all axes at the
    position 0.
    """

    shoes_mm: float
    centre_mm: tuple[float, float, float]


@dataclass(frozen=True)
class Foot:
    """Foot under the bed. `at_mm` is its place in X and Y, from the reference point of the ram with all axes at the
    position 0."""

    name: str
    at_mm: tuple[float, float]


@dataclass(frozen=True)
class Mounting:
    """Guides by the letter of their axis, and feet. Both are empty if they are not known.

    Raises ModelError if there are feet that cannot twist a bed: fewer than four, or all on one line.
    """

    guides: Mapping[str, Guide] = field(default_factory=dict, hash=False)
    feet: tuple[Foot, ...] = ()

    def __post_init__(self) -> None:
        if not self.feet:
            return
        if len(self.feet) < FEWEST_FEET:
            raise ModelError(
                f"{len(self.feet)} feet cannot twist a bed: any three heights only tilt it",
                hint="State all feet of the bed, or none",
                key="feet",
            )
        sizes = np.linalg.svd(_twist_and_plane(self.places), compute_uv=False)
        if sizes[-1] < _FLAT * sizes[0]:
            raise ModelError(
                "the feet cannot twist the bed: they do not stand on two lines beside each other",
                hint="State the feet at their places in X and Y, in mm",
                key="feet",
            )

    @property
    def places(self) -> Array:
        """Places (n, 2) of the feet in X and Y, in mm."""
        return np.array([foot.at_mm for foot in self.feet], dtype=np.float64).reshape(-1, 2)

    @property
    def middle(self) -> Array:
        """Mean place (2,) of the feet."""
        return np.asarray(self.places.mean(axis=0))

    def heights_mm(self, twist_per_mm: float) -> tuple[float, ...]:
        """Return by how much each foot must be raised, in mm, so that the bed twists by `twist_per_mm`, the change in
        rad per mm of Y of its slope along X. No foot is lowered."""
        centred = self.places - self.middle
        heights = twist_per_mm * centred[:, 0] * centred[:, 1]
        plane = np.column_stack((np.ones(len(centred)), centred))
        # the plane that fits best only tilts the bed as a whole
        heights = heights - plane @ np.linalg.lstsq(plane, heights, rcond=None)[0]
        return tuple((heights - heights.min()).tolist())


def require_shoes_within_travel(mounting: Mounting, ranges_mm: Ranges) -> None:
    """Raise ModelError if the shoes of a guide are farther apart than the travel of its axis, `ranges_mm`, is long.

    The carriage would then not reach the places at which its rail can be shimmed, and no measurement would show them.
    """
    for axis, (low, high) in zip(AXES, ranges_mm, strict=True):
        guide = mounting.guides.get(axis)
        if guide is not None and not 0.0 < guide.shoes_mm <= high - low:
            raise ModelError(
                f"the shoes of {axis} are {guide.shoes_mm:g} mm apart, but {axis} travels {high - low:g} mm",
                hint="State the distance along the axis from the first to the last shoe; leave the guide out if it is "
                "longer than the travel",
                key=f"axes.{axis}.guide.shoes_mm",
            )


def _twist_and_plane(places: Array) -> Array:
    """Return the heights (n, 4) of feet in a twist, a lift and two tilts, in comparable sizes."""
    centred = (places - places.mean(axis=0)) / max(float(np.ptp(places, axis=0).max()), 1.0)
    return np.column_stack((centred[:, 0] * centred[:, 1], np.ones(len(centred)), centred))


def require_distinct_feet(feet: Sequence[Foot]) -> None:
    """Raise ModelError if two feet have the same name."""
    names = [foot.name for foot in feet]
    for name in names:
        if names.count(name) > 1:
            raise ModelError(f"foot '{name}' is listed twice", hint="Give each foot its own name", key="feet")
