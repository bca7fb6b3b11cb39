"""The fastest way of the tip between two places among standing bodies that is proved to be free.

A way is a row of straight moves, each from rest to rest. Candidates are ordered by what they cost; the first one that
keeps its clearance all along, by the exact swept distance of every pair of bodies, is the fastest of them. A shortest
path among obstacles need not be among the candidates; a free one always is, as long as the caller names one.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np

from twin.arrays import Array
from twin.collision import Scene
from twin.geometry import Point, point
from twin.motion import travel_times

RETRACTS_MM = (0.0, 4.0, 8.0, 14.0, 22.0, 32.0, 45.0, 65.0, 95.0, 140.0, 200.0, 300.0)
"""How far before the nearer end the candidates go back."""
FRACTIONS = (0.0, 0.15, 0.5, 0.85, 1.0)
"""Where between both ends a way with one corner has it."""

SLANT = 0.2
"""Sideways on the way back from a surface: the stylus comes free of it at once."""


@dataclass(frozen=True)
class Dynamics:
    """Of the axes X, Y, Z; `command_s` comes on top of each move."""

    rapid_mm_per_s: Point
    acceleration_mm_per_s2: Point
    command_s: float = 0.0

    def seconds(self, corners: Array) -> Array:
        """(n,) of ways through `corners` (n, k, 3), the ends included."""
        moves = travel_times(corners[:, :-1], corners[:, 1:], self.rapid_mm_per_s, self.acceleration_mm_per_s2)
        return np.asarray(moves.sum(axis=1) + self.command_s * moves.shape[1])


@dataclass(frozen=True)
class Apart:
    """What a way keeps: `clearance_mm` between all bodies but the pairs (moving, obstacle) in `closer`."""

    clearance_mm: float
    closer: Mapping[tuple[str, str], float] = field(default_factory=dict)


@dataclass(frozen=True)
class Way:
    """Corners between start and end, and the seconds of the whole."""

    corners: tuple[Point, ...]
    seconds: float


def fastest(
    scene: Scene, dynamics: Dynamics, start: Point, end: Point, corners: Sequence[Array], apart: Apart
) -> Way | None:
    """The fastest of the candidates that is free; None where none is.

    `corners`: arrays (n, k, 3) of n candidates with k corners each, k = 0 for the straight way.
    """
    firsts = np.cumsum([0, *(len(group) for group in corners)])
    seconds = np.concatenate([dynamics.seconds(_whole(start, group, end)) for group in corners])
    proved: dict[tuple[Point, Point], bool] = {}

    def free(leg: tuple[Point, Point]) -> bool:
        if leg not in proved:
            proved[leg] = scene.free(*leg, apart.clearance_mm, apart.closer)
        return proved[leg]

    for index in np.argsort(seconds, kind="stable").tolist():
        group = int(np.searchsorted(firsts, index, side="right")) - 1
        between = tuple(point(corner) for corner in corners[group][index - firsts[group]].tolist())
        if all(free(leg) for leg in _legs(start, between, end)):
            return Way(between, float(seconds[index]))
    return None


def _legs(start: Point, corners: tuple[Point, ...], end: Point) -> list[tuple[Point, Point]]:
    """Each as it has to be looked along. Both ends are given and may be nearer to something than a way should be: a
    leg is looked along from there, so that bodies which part do not count."""
    stops = (start, *corners)
    return [(end, stops[-1]) if corners else (start, end), *pairwise(stops)]


def straight_and_retracted(
    start: Point, end: Point, back: Array, least: float, aside: Array | None = None
) -> list[Array]:
    """Candidates for `fastest`: straight, with one corner, and out, across and in, for each of `RETRACTS_MM`.

    `back` (3,): unit vector along a machine axis in which the probe draws back, to no less than `least` against it.
    `aside` (3,): by so much it moves away from what it touches first, and by `SLANT` while it draws back.
    """
    first, last = np.array(start), np.array(end)
    planes = np.unique(np.maximum(min(first @ -back, last @ -back) - np.array(RETRACTS_MM), least))
    out = _at_depth(np.broadcast_to(first, (len(planes), 3)), back, planes)
    if aside is not None:
        beside = float(np.linalg.norm(aside))
        sideways = np.maximum(1.0, SLANT / beside * (first @ -back - planes))
        out = out + sideways[:, None] * (aside - (aside @ back) * back)
    over = _at_depth(np.broadcast_to(last, (len(planes), 3)), back, planes)
    middles = [out + fraction * (over - out) for fraction in FRACTIONS]
    groups = [np.empty((1, 0, 3)), np.concatenate(middles)[:, None], np.stack([out, over], axis=1)]
    if aside is not None:
        groups.append((first + aside)[None, None])
    return groups


def _at_depth(points: Array, back: Array, planes: Array) -> Array:
    """(n, 3): each point at its plane."""
    return np.asarray(points + np.outer(points @ -back - planes, back))


def _whole(start: Point, corners: Array, end: Point) -> Array:
    count = len(corners)
    first, last = np.broadcast_to(np.array([[start], [end]]), (2, count, 3))
    return np.concatenate([first[:, None], corners, last[:, None]], axis=1)
