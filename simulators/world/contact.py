"""Calculation of the first contact between stylus tip and ball on a straight path, including the machine's deviation
(the error of the tip position).

The intersection of a straight line with a sphere has a closed form. The contact point is first calculated with the
deviation at the ball. Because the deviation changes by less than 0.1 µm per mm, one further calculation, with the
deviation at the contact point thus found, leaves an error far below a nanometre.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from simulators.world.field import TableField, TipShift
from simulators.world.workpiece import WorkpieceSnapshot
from twin.collision.geometry import Point, translate_point
from twin.collision.motion_law import StraightPath, entry_distance

_ROUNDING_MM = 1e-6
"""Distance beyond the end of a path up to which balls are included in the exact intersection test."""


class Contact(NamedTuple):
    """First contact of the stylus tip with a ball on a path.

    `distance` is the length of the path in mm up to the contact, and `ball` is the number of the ball, counted from 0.
    """

    distance: float
    ball: int


class ContactSolver:
    """Solver for the contacts of one stylus tip with the balls of the artefacts.

    `reach` is the distance in mm between the centres of tip and ball at contact: the tip radius plus the ball radius.
    """

    def __init__(self, tool_offset: Point, reach: float, shift: TipShift) -> None:
        self._tool = tool_offset
        self._reach = reach
        self._shift = shift
        self._near: tuple[WorkpieceSnapshot, TableField | None, Sequence[Point]] | None = None
        self._last: tuple[Point, TableField | None, Point] | None = None

    def first(self, path: StraightPath, snapshot: WorkpieceSnapshot, resting: int | None) -> Contact | None:
        """Return the first contact along `path`, or None if the tip reaches no ball.

        `snapshot` contains the true ball centres. The ball with the number `resting`, which deflects the probe at the
        start of the path, is ignored. A ball that the tip touches at the start without having tripped the probe is met
        at a distance below zero if the path presses on.
        """
        first: Contact | None = None
        start = translate_point(path.start, self._shift.rigid)
        (x, y, z), (dx, dy, dz), within = start, path.direction, path.length + self._reach + _ROUNDING_MM
        for ball, apparent in enumerate(self._apparent(snapshot)):
            ahead = (apparent[0] - x) * dx + (apparent[1] - y) * dy + (apparent[2] - z) * dz
            # A ball behind the start or beyond the end cannot be met first; this cheap test spares the square root for
            # most balls.
            if not 0.0 < ahead <= within or ball == resting:
                continue
            distance = _contact_distance(start, path, apparent, self._reach)
            if distance is not None and (first is None or distance < first.distance):
                first = Contact(distance, ball)
        return self._refine(first, path, snapshot) if first and self._shift.has_field else first

    def forget(self) -> None:
        """Forget what was computed with the former zero of the axes."""
        self._near = self._last = None

    def tip(self, axis_position: Point) -> Point:
        """Return the tip centre in mm in the workpiece frame if the axes display `axis_position`.

        The last result is cached, because the axes are often at rest.
        """
        last = self._last
        if last is None or last[0] != axis_position or last[1] is not self._shift.table:
            field = self._shift.field_at(axis_position)
            self._last = last = (axis_position, self._shift.table, field)
        return translate_point(translate_point(axis_position, self._tool), translate_point(self._shift.rigid, last[2]))

    def resting_on(self, axis_position: Point, snapshot: WorkpieceSnapshot) -> int | None:
        """Return the number of the ball against which the tip is pressed, or None if the tip touches no ball."""
        tip = self.tip(axis_position)
        for ball, centre in enumerate(snapshot.balls):
            if math.dist(tip, centre) < self._reach:
                return ball
        return None

    def pressing(self, path: StraightPath, centre: Point) -> bool:
        """Return True if a motion along `path`, which starts in contact, initially presses the tip further against the
        ball that it touches.

        `centre` is the centre of this ball.
        """
        return _closing(self.tip(path.start), path.direction, centre) < 0.0

    def deeper(self, path: StraightPath, centre: Point, overtravel: float) -> float | None:
        """Return the path distance in mm at which the deflection of the tip begins to exceed `overtravel` mm, the
        permitted deflection.

        The tip is deflected by the ball with the given `centre`. Returns None if the deflection never exceeds
        `overtravel` on the path.
        """
        return entry_distance(self.tip(path.start), path, centre, self._reach - overtravel)

    def leaving(self, path: StraightPath, centre: Point) -> float:
        """Return the path distance in mm at which a tip that starts in contact separates from the ball at `centre`.

        Returns infinity if the path ends before the tip separates.
        """
        tip = self.tip(path.start)
        closing = _closing(tip, path.direction, centre)
        inside = self._reach**2 - math.dist(tip, centre) ** 2
        # Larger root of |tip + s d - c|² = reach²: s = -b + sqrt(b² + reach² - |tip - c|²), b = (tip - c)·d.
        distance = -closing + math.sqrt(max(closing * closing + inside, 0.0))
        return distance if distance <= path.length else math.inf

    def _refine(self, contact: Contact, path: StraightPath, snapshot: WorkpieceSnapshot) -> Contact | None:
        # Second iteration: solve again with the deviation at the first solution.
        field = self._shift.field_at(path.at(contact.distance))
        start = translate_point(translate_point(path.start, self._tool), translate_point(self._shift.rigid, field))
        distance = _contact_distance(start, path, snapshot.balls[contact.ball], self._reach)
        return None if distance is None else Contact(distance, contact.ball)

    def _apparent(self, snapshot: WorkpieceSnapshot) -> Sequence[Point]:
        """Return, for each ball, the displayed axis position at which the tip centre would be at the ball centre.

        The rigid shift of the tip is not included.

        The positions are cached until the pose or the table changes.
        """
        cached = self._near
        if cached is None or cached[0] is not snapshot or cached[1] is not self._shift.table:
            nominal = np.array(snapshot.balls, dtype=np.float64).reshape(-1, 3) - self._tool
            apparent = nominal - self._shift.field_at_many(nominal)
            points = [(x, y, z) for x, y, z in apparent.tolist()]
            self._near = cached = (snapshot, self._shift.table, points)
        return cached[2]


def _contact_distance(tip: Point, path: StraightPath, centre: Point, reach: float) -> float | None:
    """Return the distance along `path` at which a tip that starts at `tip` comes within `reach` of the point `centre`.

    The distance is negative if the tip is within `reach` already and the path presses on: so far back would the contact
    have been. None if the tip never comes within `reach`, or leaves.
    """
    inside = reach**2 - math.dist(tip, centre) ** 2
    if inside <= 0.0:
        return entry_distance(tip, path, centre, reach)
    closing = _closing(tip, path.direction, centre)
    # the smaller root of |tip + s d - c|² = reach², in the form without cancellation
    return -inside / (math.sqrt(closing**2 + inside) - closing) if closing < 0.0 else None


def _closing(tip: Point, direction: Point, centre: Point) -> float:
    return sum((p - c) * d for p, c, d in zip(tip, centre, direction, strict=True))
