"""Where the tip is at a ball, and the first corners of ways from there: off the surface, and round the ball."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from twin.arrays import Array
from twin.collision.free_paths import PathCandidates
from twin.collision.geometry import Point, point

ROUND_THE_BALL = (1.05, 1.2, 1.4, 1.7)
"""Corners of the ways round a ball, in units of the distance at which touches begin."""

AHEAD_OF_THE_BALL = (0.0, 0.4, 0.8, 1.6)
"""How far before the ball these corners lie, in units of its distance to either side."""

LEAST_ASIDE = 0.1
"""Where both touches are opposite each other, a corner less far aside is none."""

LEAVING = 0.15
"""Least cosine between the normal at a touch and the first move away from it: the stylus must come free at once."""

LEAST_MOVE_MM = 1e-3
"""Less is no move."""

LEAVES_BY_MM = 3.0
"""How far the stylus leaves the surface before it draws back, where it does not leave at once."""


@dataclass(frozen=True)
class Spot:
    """Where the tip may be at a ball: out from its centre by `out_mm` against the unit vector `direction`.

    `touching`: at the surface, after a touch.
    """

    ball: int
    direction: Point
    out_mm: float
    touching: bool = False


def round_the_ball(centre: Array, start: Spot, end: Spot, stylus_axis: Array) -> Array:
    """(n, 1, 3): corners beside the ball at `centre` (3,), between both spots and before it."""
    around = -np.array(start.direction) - np.array(end.direction)
    ways = around - np.outer(AHEAD_OF_THE_BALL, stylus_axis)
    lengths = np.sqrt((ways * ways).sum(axis=1))
    aside = lengths > LEAST_ASIDE
    units = ways[aside] / lengths[aside, None]
    out_mm = max(start.out_mm, end.out_mm) * np.array(ROUND_THE_BALL)
    return np.asarray((centre + out_mm[:, None, None] * units).reshape(-1, 1, 3))


def squared_out(first: Point, last: Point, start: Spot) -> Array:
    """(1, k, 3): off the surface, straight back, up, then across: past an end that reaches out between both."""
    beside = point(np.array(first) - LEAVES_BY_MM * np.array(start.direction)) if start.touching else first
    low = min(beside[1], last[1])
    out = [(beside[0], low, beside[2]), (beside[0], low, last[2])]
    return np.array([[beside, *out] if start.touching else out])


def leaving(first: Point, candidates: PathCandidates, start: Spot) -> PathCandidates:
    """Those from `first` whose first move goes away from the surface that is touched; one that does not move at all
    leaves the next one to do so, which may press on."""
    if not start.touching:
        return candidates
    ways = candidates.corners[:, 0] - np.array(first)
    lengths = np.linalg.norm(ways, axis=1)
    away = -ways @ np.array(start.direction) >= LEAVING * lengths
    return candidates.select(away & (lengths > LEAST_MOVE_MM))


def leaves(first: Point, last: Point, start: Spot) -> bool:
    """Whether the straight way from `first` to `last` does."""
    length = math.dist(first, last)
    away = -sum((b - a) * along for a, b, along in zip(first, last, start.direction, strict=True))
    return not start.touching or (away >= LEAVING * length and length > LEAST_MOVE_MM)
