"""What the probe and ram hit on a straight move: a broad search by boxes, then exact distances."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from twin.arrays import Array
from twin.bodies import Body
from twin.geometry import Point, separation, swept_contact

_NOTHING: Mapping[tuple[str, str], float] = {}


@dataclass(frozen=True)
class Hit:
    """The first contact of a move: how far along it (0..1), and which two bodies."""

    fraction: float
    moving: str
    obstacle: str


class Scene:
    """Moving bodies (relative to the tip centre) among standing ones; build anew when those move.

    Kept is by how much the box around each moving body falls short of that around each standing one, (6, pairs) for
    the three lower and the three upper bounds, so that "they meet" is one comparison.
    """

    def __init__(self, moving: Sequence[Body], obstacles: Sequence[Body]) -> None:
        self.moving = tuple(moving)
        self.obstacles = tuple(obstacles)
        lower, upper = _bounds(self.moving)
        own = np.concatenate((lower, -upper), axis=1).T
        lower, upper = _bounds(self.obstacles)
        theirs = np.concatenate((upper, -lower), axis=1).T
        self._short = (theirs[:, None, :] - own[:, :, None]).reshape(6, -1)

    def first_hit(
        self,
        start: Point,
        end: Point,
        *,
        clearance_mm: float = 0.0,
        ignored: Collection[tuple[str, str]] = (),
    ) -> Hit | None:
        """First contact (within `clearance_mm`) when the tip centre goes straight from `start` to `end`.

        `ignored` holds (moving, obstacle) names that are meant to touch. Exact for translation; mm.
        """
        displacement = (end[0] - start[0], end[1] - start[1], end[2] - start[2])
        first: Hit | None = None
        for i, j in self.near(start, end, clearance_mm):
            body, obstacle = self.moving[i], self.obstacles[j]
            if (body.name, obstacle.name) in ignored:
                continue
            fraction = swept_contact(body.shape, obstacle.shape, displacement, clearance_mm, start)
            if fraction is not None and (first is None or fraction < first.fraction):
                first = Hit(fraction, body.name, obstacle.name)
        return first

    def free(
        self, start: Point, end: Point, clearance_mm: float, closer: Mapping[tuple[str, str], float] = _NOTHING
    ) -> bool:
        """Whether every two bodies keep `clearance_mm` from each other while the tip goes from `start` to `end`.

        `closer`: (moving, obstacle) names → what these two keep instead, where that is less. Bodies that are nearer
        at the start may go away from each other, as in `first_hit`.
        """
        displacement = (end[0] - start[0], end[1] - start[1], end[2] - start[2])
        for i, j in self.near(start, end, clearance_mm):
            body, obstacle = self.moving[i], self.obstacles[j]
            apart_mm = min(clearance_mm, closer.get((body.name, obstacle.name), clearance_mm))
            if swept_contact(body.shape, obstacle.shape, displacement, apart_mm, start) is not None:
                return False
        return True

    def shifted(self, by: Point) -> Scene:
        """The same with everything that stands moved by `by`."""
        return Scene(self.moving, [Body(body.name, body.shape.moved(by)) for body in self.obstacles])

    def clearance(self, tip: Point, *, ignored: Collection[tuple[str, str]] = (), at_most: float = math.inf) -> float:
        """Smallest distance in mm of any two bodies with the tip centre at `tip`; negative where they overlap.

        Distances beyond `at_most` are of no interest: then `at_most` is the answer, and found faster.
        """
        smallest = at_most
        for i, j in self.near(tip, tip, at_most):
            body, obstacle = self.moving[i], self.obstacles[j]
            if (body.name, obstacle.name) not in ignored:
                smallest = min(smallest, separation(body.shape.moved(tip), obstacle.shape)[0])
        return smallest

    def near(self, start: Point, end: Point, clearance_mm: float = 0.0) -> list[tuple[int, int]]:
        """Indices (moving, obstacle) of the pairs whose surrounding boxes, swept along the move, meet."""
        (x0, y0, z0), (x1, y1, z1) = start, end
        travel = np.array(
            (
                (min(x0, x1) - clearance_mm,),
                (min(y0, y1) - clearance_mm,),
                (min(z0, z1) - clearance_mm,),
                (-max(x0, x1) - clearance_mm,),
                (-max(y0, y1) - clearance_mm,),
                (-max(z0, z1) - clearance_mm,),
            )
        )
        meet = np.logical_and.reduce(travel <= self._short, axis=0)
        count = len(self.obstacles)
        return [divmod(pair, count) for pair in meet.nonzero()[0].tolist()]


def _bounds(bodies: Sequence[Body]) -> tuple[Array, Array]:
    lower = np.array([body.shape.lower for body in bodies], dtype=np.float64).reshape(-1, 3)
    upper = np.array([body.shape.upper for body in bodies], dtype=np.float64).reshape(-1, 3)
    return lower, upper
