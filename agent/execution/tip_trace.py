"""Record of the last motion of the stylus tip. It determines how the probe is withdrawn after a fault."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from twin.arrays import Array
from twin.collision.geometry import Point

WITHDRAWAL_MM = 3.0
"""Longest distance by which the tip first moves back along its path, since the stylus may be deflected."""
TOUCH_LINE_TOLERANCE_MM = 2.0
"""Largest distance from the line of a touch at which the stylus may still be deflected by that touch."""


@dataclass
class LastMotion:
    """Record of the last motion of the stylus tip, in axis positions in mm.

    The method `begin` is called when a motion begins, and `end` only if the motion ended as intended.
    """

    _at: Point | None = None
    _begun: Point | None = None
    _line: tuple[Point, Point] | None = None
    _touch: tuple[Point, Point] | None = None
    _touching: bool = False
    _target: Point | None = None
    _stand: tuple[Point, Point] | None = None

    def set_position(self, at: Point) -> None:
        """Record the axis positions that the machine has reported."""
        self._at = at

    def begin(self, target: Point, *, touch: bool) -> None:
        self._begun, self._touching = self._at, touch
        self._target, self._stand = target, None
        self._line = None if self._at is None else (self._at, target)
        if touch:
            self._touch = None if self._at is None else (self._at, target)

    def end(self, at: Point) -> None:
        if not self._touching:
            self._touch = None
        self._at, self._begun, self._line = at, None, (at, at)
        # After a trip, the axes brake between the latched position and the target.
        self._stand = (at, self._target if self._touching and self._target is not None else at)

    def forget_line(self) -> None:
        """Forget where the last motion can have led to: something else may have moved the axes since, such as a person,
        or the withdrawal of a run that is resumed."""
        self._line = self._stand = None

    def forget_stand(self) -> None:
        """Forget where the axes stand: the position that the machine displays may change while they rest, such as by
        another compensation table."""
        self._stand = None

    def distance_mm(self, here: Array) -> float:
        """Return the distance in mm of the position `here`, shape (3,), from the line of a motion that was interrupted,
        or from the position at which the last motion ended; 0 if there was none, or if its line was forgotten.
        """
        return _distance_mm(here, self._line)

    def moved_mm(self, here: Array) -> float:
        """Return the distance in mm of the position `here`, shape (3,), from where the last motion left the axes; 0 if
        this is not known, since the motion was interrupted or something else may have moved the axes since."""
        return _distance_mm(here, self._stand)

    def exit_point(self, here: Array) -> Array:
        """Return the position to which the probe moves first if it is withdrawn from the position `here`. Both are axis
        positions in mm, shape (3,).

        After a touch, the result is the position at the start of the touch. This is also the result if the motion away
        from the surface was interrupted, because a move back along the path of that motion would lead onto the surface.

        After any other interrupted motion, the result is a point on the path of this motion, at most `WITHDRAWAL_MM` (3
        mm) back from `here`. If the stylus cannot be touching anything, the result is `here`.
        """
        if self._touch is not None:
            start, target = (np.array(end) for end in self._touch)
            way = (target - start) / max(float(np.linalg.norm(target - start)), 1e-9)
            along = float((here - start) @ way)
            beside = float(np.linalg.norm(here - start - along * way))
            if beside <= TOUCH_LINE_TOLERANCE_MM and along > 0.0:
                return np.asarray(here - along * way)
            return here
        if self._begun is None:
            return here
        back = np.array(self._begun) - here
        length = float(np.linalg.norm(back))
        return np.asarray(here + back * (min(WITHDRAWAL_MM, length) / length)) if length > 0.0 else here


def _distance_mm(here: Array, line: tuple[Point, Point] | None) -> float:
    """Return the distance in mm of the position `here`, shape (3,), from a line between two points; 0 if it is None."""
    if line is None:
        return 0.0
    start, end = (np.array(one) for one in line)
    way = end - start
    square = float(way @ way)
    # Foot of the perpendicular as a fraction of the line, t = (p - a)·(b - a) / |b - a|², limited to 0 … 1.
    fraction = float(np.clip((here - start) @ way / square, 0.0, 1.0)) if square > 0.0 else 0.0
    return float(np.linalg.norm(here - start - fraction * way))
