"""Spindle directions as a person writes them, and the direction of holders and shaft that suits them."""

from __future__ import annotations

from twin.collision.probe_frame import VERTICAL, ProbeFrame
from twin.errors import DataError
from twin.machine.kinematic_chain import AXES

Vector = tuple[float, float, float]

SIGNS = {"+": 1, "-": -1}
BESIDE: Vector = (0.0, -1.0, 0.0)
"""Direction of a shaft along the elevation axis, in the artefact frame: the artefact stands beside the azimuth axis."""


def parse_spindle(text: str) -> ProbeFrame:
    """Return the probe frame of a spindle direction written as a sign and an axis, such as -Z: the direction from the
    ram reference to the stylus centre. Raises DataError for any other text.
    """
    sign, letter = SIGNS.get(text[:1]), text[1:].upper()
    if sign is None or letter not in AXES:
        raise DataError(
            f"'{text}' is not a spindle direction",
            hint="write a sign and an axis, from the spindle to the stylus: -Z for a vertical spindle, +Y, -X",
        )
    return ProbeFrame(AXES.index(letter), sign)


def spindle_name(spindle: ProbeFrame) -> str:
    """Return a spindle direction as text, such as -Z."""
    return f"{'+' if spindle.sign > 0 else '-'}{AXES[spindle.axis]}"


SPINDLES = tuple(f"{sign}{axis}" for axis in AXES for sign in SIGNS)
"""All spindle directions as text."""


def points_up(spindle: ProbeFrame) -> bool:
    """Return True if the stylus points upwards and probes from below."""
    return spindle.axis == VERTICAL and spindle.sign > 0


def holder_direction(spindle: ProbeFrame) -> Vector:
    """Return the direction of holders and shaft in the artefact frame, which is opposite to the stylus.

    If the stylus is vertical, the direction is along Z, and the artefact stands above the azimuth axis or hangs below
    it. Otherwise it is -Y, and the azimuth of the mount turns it towards the stylus."""
    return (0.0, 0.0, -float(spindle.sign)) if spindle.is_vertical else BESIDE
