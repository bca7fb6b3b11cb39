"""Where the tip is at a ball, and the first corners of ways from there: off the surface, and round the ball."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from twin.arrays import Array
from twin.collision.free_paths import PathCandidates
from twin.collision.geometry import Point, point

DETOUR_RADII = (1.05, 1.2, 1.4, 1.7)
"""Corners of the ways round a ball, in units of the distance at which touches begin."""

DETOUR_SETBACKS = (0.0, 0.4, 0.8, 1.6)
"""How far before the ball these corners lie, in units of its distance to either side."""

MIN_LATERAL_COMPONENT = 0.1
"""Where both touches are opposite each other, a corner less far aside is none."""

MIN_LIFT_OFF_COSINE = 0.15
"""Least cosine between the normal at a touch and the first move away from it: the stylus must come free at once."""

MIN_MOVE_MM = 1e-3
"""Less is no move."""

LIFT_OFF_MM = 3.0
"""How far the stylus leaves the surface before it draws back, where it does not leave at once."""


@dataclass(frozen=True)
class TipLocation:
    """Where the tip may be at a ball: out from its centre by `out_mm` against the unit vector `direction`.

    `touching`: at the surface, after a touch.
    """

    ball: int
    direction: Point
    out_mm: float
    touching: bool = False


def detour_corners(centre: Array, start: TipLocation, end: TipLocation, stylus_axis: Array) -> Array:
    """(n, 1, 3): corners beside the ball at `centre` (3,), between both spots and before it."""
    around = -np.array(start.direction) - np.array(end.direction)
    ways = around - np.outer(DETOUR_SETBACKS, stylus_axis)
    lengths = np.sqrt((ways * ways).sum(axis=1))
    aside = lengths > MIN_LATERAL_COMPONENT
    units = ways[aside] / lengths[aside, None]
    out_mm = max(start.out_mm, end.out_mm) * np.array(DETOUR_RADII)
    return np.asarray((centre + out_mm[:, None, None] * units).reshape(-1, 1, 3))


def rectangular_exit(first: Point, last: Point, start: TipLocation) -> Array:
    """(1, k, 3): off the surface, straight back, up, then across: past an end that reaches out between both."""
    beside = point(np.array(first) - LIFT_OFF_MM * np.array(start.direction)) if start.touching else first
    low = min(beside[1], last[1])
    out = [(beside[0], low, beside[2]), (beside[0], low, last[2])]
    return np.array([[beside, *out] if start.touching else out])


def lifting_off(first: Point, candidates: PathCandidates, start: TipLocation) -> PathCandidates:
    """Those from `first` whose first move goes away from the surface that is touched; one that does not move at all
    leaves the next one to do so, which may press on."""
    if not start.touching:
        return candidates
    ways = candidates.corners[:, 0] - np.array(first)
    lengths = np.linalg.norm(ways, axis=1)
    away = -ways @ np.array(start.direction) >= MIN_LIFT_OFF_COSINE * lengths
    return candidates.select(away & (lengths > MIN_MOVE_MM))


def lifts_off(first: Point, last: Point, start: TipLocation) -> bool:
    """Whether the straight way from `first` to `last` does."""
    length = math.dist(first, last)
    away = -sum((b - a) * along for a, b, along in zip(first, last, start.direction, strict=True))
    return not start.touching or (away >= MIN_LIFT_OFF_COSINE * length and length > MIN_MOVE_MM)
