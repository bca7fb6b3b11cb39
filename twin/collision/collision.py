"""Collisions of the probe and the ram with other bodies during a straight move.

Bounding boxes are tested first. Exact distances are computed only for pairs of bodies whose boxes come closer than the
clearance.
"""

from __future__ import annotations

import math
from bisect import bisect_left, bisect_right
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from itertools import accumulate
from operator import or_
from typing import TypeAlias

from twin.collision.bodies import Body
from twin.collision.geometry import Point, separation, swept_contact
from twin.immutable import Immutable

_NOTHING: Mapping[tuple[str, str], float] = {}


@dataclass(frozen=True)
class Hit:
    """First contact between a moving body and an obstacle during a straight move. `fraction` is the fraction of the
    move (0 to 1) at which the contact occurs. `moving` and `obstacle` are the names of the two bodies.
    """

    fraction: float
    moving: str
    obstacle: str


class Scene(Immutable):
    """Collision scene with moving bodies, given relative to the centre of the stylus tip, among stationary bodies.

    A scene cannot be changed. If a stationary body moves, a new scene is needed.

    The constructor computes the bounding boxes of the moving bodies and the sorted extents of the bounding boxes of the
    stationary bodies in advance.
    """

    def __init__(self, moving: Sequence[Body], obstacles: Sequence[Body]) -> None:
        self.moving = tuple(moving)
        self.obstacles = tuple(obstacles)
        self._boxes = [(body.shape.lower, body.shape.upper) for body in self.moving]
        lower, upper = [body.shape.lower for body in self.obstacles], [body.shape.upper for body in self.obstacles]
        self._along_x, self._along_y, self._along_z = (
            _spans([low[axis] for low in lower], [high[axis] for high in upper]) for axis in range(3)
        )

    def first_hit(
        self,
        start: Point,
        end: Point,
        *,
        clearance_mm: float = 0.0,
        ignored: Collection[tuple[str, str]] = (),
    ) -> Hit | None:
        """Return the first contact during a straight move of the tip centre from `start` to `end`, or None if there is
        no contact.

        Two bodies are in contact if their distance is at most `clearance_mm`. If two bodies are already that close at
        the start, this counts as a contact only if the move brings them closer. Coordinates are in mm. `ignored`
        contains the pairs of names (moving, obstacle) of bodies that are allowed to touch. The result is exact, because
        the bodies only translate.
        """
        displacement = (end[0] - start[0], end[1] - start[1], end[2] - start[2])
        first: Hit | None = None
        for i, j in self.near_pairs(start, end, clearance_mm):
            body, obstacle = self.moving[i], self.obstacles[j]
            if (body.name, obstacle.name) in ignored:
                continue
            fraction = swept_contact(body.shape, obstacle.shape, displacement, clearance_mm, start)
            if fraction is not None and (first is None or fraction < first.fraction):
                first = Hit(fraction, body.name, obstacle.name)
        return first

    def is_free(
        self, start: Point, end: Point, clearance_mm: float, reduced_mm: Mapping[tuple[str, str], float] = _NOTHING
    ) -> bool:
        """Return True if all moving bodies keep their clearance from all obstacles on the straight move from `start` to
        `end`.

        The clearance of a pair of bodies is `clearance_mm`, or a smaller value if `reduced_mm` contains the pair of
        names (moving, obstacle). Bodies that are closer than their clearance at the start are permitted to move apart.
        """
        displacement = (end[0] - start[0], end[1] - start[1], end[2] - start[2])
        for i, j in self.near_pairs(start, end, clearance_mm):
            body, obstacle = self.moving[i], self.obstacles[j]
            apart_mm = min(clearance_mm, reduced_mm.get((body.name, obstacle.name), clearance_mm))
            if swept_contact(body.shape, obstacle.shape, displacement, apart_mm, start) is not None:
                return False
        return True

    def translated(self, by: Point) -> Scene:
        """Return a new scene in which all stationary bodies are translated by the vector `by` in mm."""
        return Scene(self.moving, [Body(body.name, body.shape.translated(by)) for body in self.obstacles])

    def clearance(self, tip: Point, *, ignored: Collection[tuple[str, str]] = (), at_most: float = math.inf) -> float:
        """Return the smallest distance in mm between a moving body and an obstacle if the tip centre is at `tip`.

        The distance is negative if the two bodies overlap. `ignored` contains the pairs of names (moving, obstacle)
        that are left out. To save time, distances larger than `at_most` are not computed. If all distances are larger,
        the result is `at_most`.
        """
        smallest = at_most
        for i, j in self.near_pairs(tip, tip, at_most):
            body, obstacle = self.moving[i], self.obstacles[j]
            if (body.name, obstacle.name) not in ignored:
                smallest = min(smallest, separation(body.shape.translated(tip), obstacle.shape)[0])
        return smallest

    def near_pairs(self, start: Point, end: Point, clearance_mm: float = 0.0) -> list[tuple[int, int]]:
        """Return the indices (moving, obstacle) of all pairs of bodies whose bounding boxes come closer than
        `clearance_mm` during a straight move of the tip centre from `start` to `end`.

        The box of each moving body is extended to enclose the body during the complete move.
        """
        (x0, y0, z0), (x1, y1, z1) = start, end
        x0, x1 = (x0 - clearance_mm, x1 + clearance_mm) if x0 < x1 else (x1 - clearance_mm, x0 + clearance_mm)
        y0, y1 = (y0 - clearance_mm, y1 + clearance_mm) if y0 < y1 else (y1 - clearance_mm, y0 + clearance_mm)
        z0, z1 = (z0 - clearance_mm, z1 + clearance_mm) if z0 < z1 else (z1 - clearance_mm, z0 + clearance_mm)
        # Overlap per axis is a bit set of obstacles; the sets of the three axes are intersected.
        # The sets of `_Spans` are looked up here: a call for each body and axis would take longer than the look-up.
        x_lowers, x_begun, x_uppers, x_left = self._along_x
        y_lowers, y_begun, y_uppers, y_left = self._along_y
        z_lowers, z_begun, z_uppers, z_left = self._along_z
        pairs = []
        for i, ((lx, ly, lz), (ux, uy, uz)) in enumerate(self._boxes):
            met = z_begun[bisect_right(z_lowers, uz + z1)] & z_left[bisect_left(z_uppers, lz + z0)]
            if met:
                met &= x_begun[bisect_right(x_lowers, ux + x1)] & x_left[bisect_left(x_uppers, lx + x0)]
            if met:
                met &= y_begun[bisect_right(y_lowers, uy + y1)] & y_left[bisect_left(y_uppers, ly + y0)]
            while met:
                # The lowest bit that is set.
                last = met & -met
                pairs.append((i, last.bit_length() - 1))
                met ^= last
        return pairs


_Spans: TypeAlias = tuple[Sequence[float], Sequence[int], Sequence[float], Sequence[int]]
"""Extents of bodies along one axis: `lowers`, `begun`, `uppers`, `left`. A set of bodies is an integer in which bit j
stands for body j.

`lowers`: lower bounds in ascending order; `begun[n]`: the set of the n bodies with the smallest lower bounds. `uppers`:
upper bounds in ascending order; `left[n]`: the set of all bodies except the n with the smallest upper bounds. The
bodies whose extent overlaps the interval from a to b, ends included, are those that begin up to b and do not end before
a: `begun[bisect_right(lowers, b)] & left[bisect_left(uppers, a)]`.
"""


def _spans(lower: Sequence[float], upper: Sequence[float]) -> _Spans:
    from_below = sorted((low, 1 << body) for body, low in enumerate(lower))
    from_above = sorted((high, 1 << body) for body, high in enumerate(upper))
    begun = accumulate((bit for _, bit in from_below), or_, initial=0)
    left = accumulate((bit for _, bit in reversed(from_above)), or_, initial=0)
    return [low for low, _ in from_below], [*begun], [high for high, _ in from_above], [*left][::-1]
