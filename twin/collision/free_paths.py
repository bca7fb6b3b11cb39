"""Fastest collision-free path of the tip between two points among stationary bodies.

A path is a sequence of straight moves, each from rest to rest. Candidate paths are tested in order of duration. The
first that keeps the clearance along all moves, according to the exact swept distance of every pair of bodies, is the
fastest free candidate. The candidates need not include the shortest path among the obstacles. A free path is always
found if the caller adds one to the candidates.
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

RETRACTS_MM = (0.0, 4.0, 8.0, 14.0, 22.0, 32.0, 45.0, 65.0, 95.0, 140.0, 200.0, 300.0)
"""Retract distances of the candidates in mm, measured from whichever of start and end is nearer to the ram."""
CORNER_FRACTIONS = (0.0, 0.15, 0.5, 0.85, 1.0)
"""Positions of the corner of one-corner candidates, as fractions of the distance from start to end."""
_SHARES = np.array(CORNER_FRACTIONS)[:, None, None]

RETRACT_SLANT = 0.2
"""Lateral motion away from the surface per unit of retract distance, so that the stylus leaves the surface at once."""


@dataclass(frozen=True)
class AxisDynamics:
    """Rapid speed and acceleration of the axes X, Y, Z; `command_s` is the additional time in s for each move."""

    rapid_mm_per_s: Point
    acceleration_mm_per_s2: Point
    command_s: float = 0.0

    def seconds(self, corners: Array) -> Array:
        """Return the duration (n,) in s of n paths through `corners` (n, k, 3) mm, which include start and end."""
        return np.asarray(self.moving_seconds(corners) + self.command_s * (corners.shape[1] - 1))

    def moving_seconds(self, corners: Array) -> Array:
        """Return the duration (n,) in s of the same paths without the additional time for each move."""
        moves = travel_times(corners[:, :-1], corners[:, 1:], self.rapid_mm_per_s, self.acceleration_mm_per_s2)
        return np.asarray(moves.sum(axis=1))


@dataclass(frozen=True)
class Clearances:
    """Required clearances in mm.

    `reduced_mm`: map from a pair of names (moving, obstacle) to the clearance of this pair; `clearance_mm`: clearance
    of all other pairs.
    """

    clearance_mm: float
    reduced_mm: Mapping[tuple[str, str], float] = field(default_factory=dict)


@dataclass(frozen=True)
class FreePath:
    """Corners of a path between start and end, and its total duration in s."""

    corners: tuple[Point, ...]
    seconds: float


@dataclass(frozen=True, eq=False)
class PathCandidates:
    """Candidate paths: `corners` (n, k, 3) mm and `counts` (n,), the number of corners of each path, at least one.

    A path with fewer than k corners repeats its last one.
    """

    corners: Array
    counts: NDArray[np.int_]

    @classmethod
    def of(cls, groups: Sequence[Array]) -> PathCandidates:
        """Combine groups of candidates; each group is an array (n, k, 3) of n paths with k corners."""
        total, most = sum(map(len, groups)), max(group.shape[1] for group in groups)
        corners, counts, begin = np.empty((total, most, 3)), np.empty(total, dtype=np.int_), 0
        for group in groups:
            end, count = begin + len(group), group.shape[1]
            corners[begin:end, :count], corners[begin:end, count:] = group, group[:, -1:]
            counts[begin:end], begin = count, end
        return cls(corners, counts)

    def select(self, mask: NDArray[np.bool_]) -> PathCandidates:
        """Return the candidates selected by `mask` (n,) bool."""
        return PathCandidates(self.corners[mask], self.counts[mask])

    def inside(self, lower: Array, upper: Array) -> PathCandidates:
        """Return the candidates with all corners between `lower` and `upper`, (3,) each, in mm."""
        within = (self.corners >= lower) & (self.corners <= upper)
        return self.select(np.asarray(within.reshape(len(within), -1).all(axis=1)))


@dataclass(frozen=True, eq=False)
class PrefilteredScene:
    """Scene together with the spheres in it, for a fast first collision test."""

    scene: Scene
    spheres: SceneSpheres

    @classmethod
    def of(cls, scene: Scene) -> PrefilteredScene:
        return cls(scene, SceneSpheres.of(scene))


def direct_path(
    scene: Scene, dynamics: AxisDynamics, start: Point, end: Point, clearances: Clearances
) -> FreePath | None:
    """Return the straight path if it is free, otherwise None; no other path is faster."""
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
    """Return the fastest free candidate, or None if no candidate is free.

    If several are equally fast, the first of them is returned.
    """
    stops = _stops(start, candidates.corners, end)
    seconds = dynamics.moving_seconds(stops) + dynamics.command_s * (candidates.counts + 1)
    spheres = SpherePrefilter(prefiltered.spheres, clearances.clearance_mm, clearances.reduced_mm)
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
    """Return candidates (n, k, 3) for `fastest_path`, for each distance of `RETRACTS_MM`.

    A candidate has one corner, or it retracts, crosses and advances. `back` (3,): unit vector along a machine axis in
    which the probe retracts; `limit`: smallest coordinate along -`back` that the probe may reach. `lateral` (3,):
    direction away from the touched surface at the start; the lateral displacement grows by `RETRACT_SLANT` per unit of
    retract distance.
    """
    first, last = np.array(start), np.array(end)
    # Coordinates against `back`; each retract gives a plane in which the probe crosses over.
    begins, ends = float(first @ -back), float(last @ -back)
    planes = np.array(sorted({max(min(begins, ends) - retract, limit) for retract in RETRACTS_MM}))
    out = first + (begins - planes)[:, None] * back
    if lateral is not None:
        beside = math.hypot(*lateral.tolist())
        sideways = np.maximum(1.0, RETRACT_SLANT / beside * (begins - planes))
        out = out + sideways[:, None] * (lateral - (lateral @ back) * back)
    over = last + (ends - planes)[:, None] * back
    middles = out + _SHARES * (over - out)
    groups = [middles.reshape(-1, 1, 3), np.concatenate([out[:, None], over[:, None]], axis=1)]
    if lateral is not None:
        groups.append((first + lateral)[None, None])
    return groups
