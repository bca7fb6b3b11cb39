"""Fastest collision-free path of the tip between two points among stationary bodies.

A path is a sequence of straight moves, and the tip stops after each move. The caller provides a list of candidate
paths. They are tested in ascending order of duration. A test is exact: it computes the smallest distance between every
pair of bodies during each move. The first candidate that keeps the required clearance on all its moves is the fastest
collision-free candidate. There may be a shorter path among the obstacles that is not in the list. The search succeeds
if the list includes a path that is known to be free of collisions.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from twin.arrays import Array
from twin.collision.collision import Scene
from twin.collision.geometry import Point
from twin.collision.motion_law import travel_times
from twin.collision.sphere_prefilter import SceneSpheres, SpherePrefilter

# From 32 mm on, each is 1.4 to 1.5 times the one before: a retract that is longer than needed by a share costs that
# share of its time, whatever its size.
RETRACTS_MM = (0.0, 4.0, 8.0, 14.0, 22.0, 32.0, 45.0, 65.0, 95.0, 140.0, 200.0, 300.0)
"""Retract distances of the candidates in mm, measured from whichever of start and end is nearer to the ram."""
CORNER_FRACTIONS = (0.0, 0.15, 0.5, 0.85, 1.0)
"""Positions of the corner of one-corner candidates, as fractions of the distance from start to end."""
_SHARES = np.array(CORNER_FRACTIONS)[:, None, None]

RETRACT_SLANT = 0.2
"""Lateral motion away from the surface per unit of retract distance, so that the stylus leaves the surface at once."""


@dataclass(frozen=True)
class AxisDynamics:
    """Rapid speed and acceleration of the axes X, Y, Z, and the additional time `command_s` in s that each move
    takes.
    """

    rapid_mm_per_s: Point
    acceleration_mm_per_s2: Point
    command_s: float = 0.0

    def seconds(self, corners: Array) -> Array:
        """Return the duration in s of each of n paths through the points `corners` (n, k, 3) in mm. The points include
        start and end.
        """
        return np.asarray(self.moving_seconds(corners) + self.command_s * (corners.shape[1] - 1))

    def moving_seconds(self, corners: Array) -> Array:
        """Return the duration in s of each of n paths through the points `corners` (n, k, 3) in mm, without the
        additional time `command_s` for each move.
        """
        moves = travel_times(corners[:, :-1], corners[:, 1:], self.rapid_mm_per_s, self.acceleration_mm_per_s2)
        return np.asarray(moves.sum(axis=1))


@dataclass(frozen=True)
class Clearances:
    """Required clearances between moving bodies and obstacles, in mm.

    `reduced_mm` is a mapping from a pair of names (moving, obstacle) to the clearance of this pair. `clearance_mm` is
    the clearance of all other pairs.
    """

    clearance_mm: float
    reduced_mm: Mapping[tuple[str, str], float] = field(default_factory=dict)


@dataclass(frozen=True)
class FreePath:
    """Collision-free path: its corners between start and end, and its total duration in s."""

    corners: tuple[Point, ...]
    seconds: float


@dataclass(frozen=True, eq=False)
class PathCandidates:
    """Candidate paths of the tip, among which a collision-free path is searched. `corners` (n, k, 3) contains up to k
    corners (points between start and end) in mm for each of n paths. `counts` (n,) contains the number of corners of
    each path, which is at least one.

    If a path has fewer than k corners, its last corner is repeated.
    """

    corners: Array
    counts: NDArray[np.int_]

    @classmethod
    def of(cls, groups: Sequence[Array]) -> PathCandidates:
        """Combine several groups of candidate paths into one. Each group is an array (n, k, 3) of n paths with k
        corners.
        """
        total, most = sum(map(len, groups)), max(group.shape[1] for group in groups)
        corners, counts, begin = np.empty((total, most, 3)), np.empty(total, dtype=np.int_), 0
        for group in groups:
            end, count = begin + len(group), group.shape[1]
            corners[begin:end, :count], corners[begin:end, count:] = group, group[:, -1:]
            counts[begin:end], begin = count, end
        return cls(corners, counts)

    def select(self, mask: NDArray[np.bool_]) -> PathCandidates:
        """Return the candidate paths that the boolean array `mask` selects."""
        return PathCandidates(self.corners[mask], self.counts[mask])

    def inside(self, lower: Array, upper: Array) -> PathCandidates:
        """Return the candidate paths whose corners are all between `lower` (3,) and `upper` (3,), in mm."""
        within = (self.corners >= lower) & (self.corners <= upper)
        return self.select(np.asarray(within.reshape(len(within), -1).all(axis=1)))


@dataclass(frozen=True, eq=False)
class PrefilteredScene:
    """Collision scene together with a list of the spheres in it. The spheres are used for a fast first collision
    test.
    """

    scene: Scene
    spheres: SceneSpheres

    @classmethod
    def of(cls, scene: Scene) -> PrefilteredScene:
        return cls(scene, SceneSpheres.of(scene))


def direct_path(
    scene: Scene, dynamics: AxisDynamics, start: Point, end: Point, clearances: Clearances
) -> FreePath | None:
    """Return the straight path from `start` to `end` if it is free of collisions, otherwise None. No other path is
    faster than the straight path.
    """
    if not scene.is_free(start, end, clearances.clearance_mm, clearances.reduced_mm):
        return None
    return FreePath((), float(dynamics.seconds(np.array([[start, end]]))[0]))


def fastest_path(
    prefiltered: PrefilteredScene,
    dynamics: AxisDynamics,
    start: Point,
    end: Point,
    candidates: PathCandidates,
    clearances: Clearances,
) -> FreePath | None:
    """Return the fastest of the candidate paths from `start` to `end` that is free of collisions, or None if none is
    free. If several free candidates are equally fast, the first of them is returned.
    """
    stops = _stops(start, candidates.corners, end)
    # A repeated last corner is a move of zero length, so the time of a short path is right; only its commands must be
    # counted apart.
    seconds = dynamics.moving_seconds(stops) + dynamics.command_s * (candidates.counts + 1)
    spheres = SpherePrefilter(prefiltered.spheres, clearances.clearance_mm, clearances.reduced_mm)
    # Many candidates share their first or their last move, whose test costs far more than the look-up.
    proved: dict[tuple[Point, Point], bool] = {}

    def free(leg: tuple[Point, Point]) -> bool:
        if leg not in proved:
            hit = spheres.certainly_hits(*leg)
            proved[leg] = not hit and prefiltered.scene.is_free(*leg, clearances.clearance_mm, clearances.reduced_mm)
        return proved[leg]

    # Ascending duration: the first candidate proved free is the fastest.
    for index in np.argsort(seconds, kind="stable").tolist():
        corners = candidates.corners[index, : candidates.counts[index]].tolist()
        between = tuple((x, y, z) for x, y, z in corners)
        if all(free(leg) for leg in _legs(start, between, end)):
            return FreePath(between, float(seconds[index]))
    return None


def _legs(start: Point, corners: tuple[Point, ...], end: Point) -> list[tuple[Point, Point]]:
    """Return the moves of a path, each in the direction in which it has to be checked.

    Start and end are given and may be closer to a body than the clearance. A move is therefore checked from its given
    end, because the check permits bodies that are too close at first but move away from each other.
    """
    return [(end, corners[-1]), *pairwise((start, *corners))]


def _stops(start: Point, corners: Array, end: Point) -> Array:
    """Return corners (n, k, 3) with start and end added, as an array (n, k + 2, 3)."""
    stops = np.empty((len(corners), corners.shape[1] + 2, 3))
    stops[:, 0], stops[:, 1:-1], stops[:, -1] = start, corners, end
    return stops


def retract_candidates(
    start: Point, end: Point, back: Array, limit: float, lateral: Array | None = None
) -> list[Array]:
    """Return candidate paths from `start` to `end`, for the function `fastest_path`, as a list of arrays (n, k, 3) with
    n paths of k corners.

    For each retract distance in `RETRACTS_MM` there are paths with two corners and with one corner. A path with two
    corners retracts from the start, crosses over in a plane perpendicular to `back`, and advances to the end. A path
    with one corner leads over a point of this plane.

    `back` (3,) is the unit vector along a machine axis in which the probe retracts. `limit` is the smallest permissible
    coordinate in the direction -`back`. `lateral` (3,) is a vector in mm that points away from the surface touched at
    the start. If it is given, the probe also moves sideways while it retracts. The lateral displacement grows by
    `RETRACT_SLANT` per unit of retract distance. A further candidate then has its only corner at `start` + `lateral`.
    """
    first, last = np.array(start), np.array(end)
    # Coordinates against `back`; each retract gives a plane in which the probe crosses over.
    begins, ends = float(first @ -back), float(last @ -back)
    # Measured from the end nearer to the ram, a retract of 0 already clears the step between both ends.
    planes = np.array(sorted({max(min(begins, ends) - retract, limit) for retract in RETRACTS_MM}))
    out = first + (begins - planes)[:, None] * back
    if lateral is not None:
        beside = math.hypot(*lateral.tolist())
        # at least `lateral` itself, then in proportion to the retract
        sideways = np.maximum(1.0, RETRACT_SLANT / beside * (begins - planes))
        out = out + sideways[:, None] * (lateral - (lateral @ back) * back)
    over = last + (ends - planes)[:, None] * back
    middles = out + _SHARES * (over - out)
    groups = [middles.reshape(-1, 1, 3), np.concatenate([out[:, None], over[:, None]], axis=1)]
    if lateral is not None:
        groups.append((first + lateral)[None, None])
    return groups
