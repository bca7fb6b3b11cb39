"""Geometry of the mount, which is the rotary device that holds the artefact. The geometry has a separate module,
because the settings import it and must not load numpy.

An artefact that is placed by hand has no mount. Its geometry is that of a mount without any part (see
`without_mount`), whose location is the origin of the artefact frame.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from twin.errors import DataError


@dataclass(frozen=True)
class MountGeometry:
    """Dimensions of the mount in mm. They are used to place the artefact and to check for collisions.

    The mount location is the point where the vertical azimuth axis and the elevation axis meet. A shaft connects it to
    the origin of the artefact frame, at the distance `shaft_mm`, and turns with the artefact. `shaft_direction` is the
    direction of the shaft in the artefact frame, towards the artefact; its length does not matter. The default, -Y, is
    the direction of the elevation axis: the artefact stands beside the azimuth axis. With +Z it stands above the
    azimuth axis if the elevation is 0.

    The pedestal stands on the machine table under the azimuth axis. It extends from the height `table_z_mm` (surface of
    the table, in the workpiece frame) to `head_mm` above the mount location. If `hanging` is True, the mount hangs from
    a surface above it at the height `table_z_mm`, and the pedestal ends `head_mm` below the mount location. A stylus
    that points upwards then reaches the artefact from below. A part whose radius is 0 does not exist.
    """

    shaft_mm: float = 120.0
    shaft_direction: tuple[float, float, float] = (0.0, -1.0, 0.0)
    shaft_radius_mm: float = 20.0
    pedestal_radius_mm: float = 50.0
    head_mm: float = 30.0
    table_z_mm: float = -150.0
    hanging: bool = False

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if name not in ("table_z_mm", "head_mm", "shaft_direction", "hanging") and not value >= 0.0:
                raise DataError(f"{name} must be at least 0, got {value}", key=f"mount.{name}")
        if not math.isfinite(self.head_mm):
            raise DataError(f"head_mm must be a number, got {self.head_mm}", key="mount.head_mm")
        if not 0.0 < math.hypot(*self.shaft_direction) < math.inf:
            raise DataError("shaft_direction must not be zero", key="mount.shaft_direction")

    @property
    def up(self) -> float:
        """1 if the pedestal extends upwards from the table to the mount location, -1 if it hangs down."""
        return -1.0 if self.hanging else 1.0

    @property
    def shaft_vector_mm(self) -> tuple[float, float, float]:
        """Vector in mm from the mount location to the origin of the artefact frame, in the artefact frame."""
        x, y, z = self.shaft_direction
        scale = self.shaft_mm / math.hypot(x, y, z)
        return scale * x, scale * y, scale * z


PARTS = ("shaft_mm", "shaft_radius_mm", "pedestal_radius_mm", "head_mm")
"""Keys of the section `mount` that describe parts of the mount."""


def without_mount(section: Mapping[str, Any]) -> dict[str, Any]:
    """Return the section `mount` of settings for an artefact that is placed by hand: all parts of the mount have the
    size 0, and only the height of the table remains.

    Raises ValueError, which names the key, if `section` describes a part of a mount.
    """
    described = [name for name in PARTS if section.get(name, 0.0) != 0.0]
    if described:
        raise ValueError(f"mount.{described[0]}: an artefact that is placed by hand has no mount; remove the key")
    if section.get("hanging"):
        raise ValueError("mount.hanging: an artefact that is placed by hand stands on the table; remove the key")
    return {**section, **dict.fromkeys(PARTS, 0.0)}
