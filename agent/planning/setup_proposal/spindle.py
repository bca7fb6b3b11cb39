"""Spindle directions as a person writes them."""

from __future__ import annotations

from twin.collision.probe_frame import ProbeFrame
from twin.errors import DataError
from twin.machine.kinematic_chain import AXES

SIGNS = {"+": 1, "-": -1}
UPWARDS = "+Z"
"""Direction of a stylus that probes from below."""


def parse_spindle(text: str) -> ProbeFrame:
    """Return the probe frame of a spindle direction written as a sign and an axis, such as -Z: the direction from the
    ram reference to the stylus centre. Raises DataError for any other text.
    """
    sign, letter = SIGNS.get(text[:1]), text[1:].upper()
    if f"{text[:1]}{letter}" == UPWARDS:
        raise DataError(
            "no mount can be proposed for a stylus that points upwards",
            hint="write the files from docs/reference/files.md",
        )
    if sign is None or letter not in AXES:
        raise DataError(
            f"'{text}' is not a spindle direction",
            hint="write a sign and an axis, from the spindle to the stylus: -Z for a vertical spindle, +Y, -X",
        )
    return ProbeFrame(AXES.index(letter), sign)


def spindle_name(spindle: ProbeFrame) -> str:
    """Return a spindle direction as text, such as -Z."""
    return f"{'+' if spindle.sign > 0 else '-'}{AXES[spindle.axis]}"


SPINDLES = tuple(f"{sign}{axis}" for axis in AXES for sign in SIGNS if f"{sign}{axis}" != UPWARDS)
"""All spindle directions for which a set-up can be proposed, as text."""
