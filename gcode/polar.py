"""Polar coordinates of LinuxCNC: `@` is the distance from the zero point of the program, `^` the angle in degrees."""

from __future__ import annotations

import math
from collections.abc import Container

from gcode.modal import XY_PLANE
from gcode.source import SourceLine

POLAR = frozenset("@^")

# Far above the floating-point noise of added offsets, far below any distance that a program names.
_NO_DISTANCE = 1e-9


def require_polar_plane(letters: Container[str], plane: int, source: SourceLine) -> None:
    """Raise FormatError if a block with polar coordinates also has X or Y among its `letters`, or if the `plane`, as
    `ModalState.plane` states it, is not that of X and Y."""
    if "X" in letters or "Y" in letters:
        source.refuse("X or Y together with polar coordinates")
    if plane != XY_PLANE:
        source.refuse("polar coordinates need G17")


def polar_end(
    x: float, y: float, distance: float | None, angle_deg: float | None, *, absolute: bool, source: SourceLine
) -> tuple[float, float]:
    """Return X and Y of the end of a block with polar coordinates, from the position X, Y before it.

    All lengths are in one unit and count from the zero point of the program. With G90 (`absolute`), `distance` and
    `angle_deg` are the polar coordinates of the end; the one that is None is that of the position. With G91, they are
    added to the polar coordinates of the position. Raises FormatError if the position has no angle and one is needed.
    """
    present = math.hypot(x, y)
    if present < _NO_DISTANCE and (not absolute or angle_deg is None):
        source.refuse("the position is the origin, which has no angle")
    angle = math.atan2(y, x)
    if absolute:
        present = present if distance is None else distance
        angle = angle if angle_deg is None else math.radians(angle_deg)
    else:
        present += distance or 0.0
        angle += math.radians(angle_deg or 0.0)
    return present * math.cos(angle), present * math.sin(angle)
