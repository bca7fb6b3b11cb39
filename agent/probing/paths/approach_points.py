"""Locations of the stylus tip at a ball, and the first corners of paths that lift off the ball's surface or go round
the ball."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from twin.arrays import Array
from twin.collision.free_paths import PathCandidates
from twin.collision.geometry import Point, point
from twin.collision.probe_frame import ProbeFrame

DETOUR_RADII = (1.05, 1.2, 1.4, 1.7)
"""Distances of detour corners from the ball centre, as multiples of the larger `out_mm` of both path ends."""

DETOUR_SETBACKS = (0.0, 0.4, 0.8, 1.6)
"""Displacements of detour corners along the stylus axis. They are added to the sum of the outward unit vectors at both
path ends."""

MIN_LATERAL_COMPONENT = 0.1
"""Minimum length of the sum of both direction vectors. If it is shorter, the touches are on opposite sides and no
corner lies between them."""

MIN_LIFT_OFF_COSINE = 0.15
"""Minimum cosine of the angle between the surface normal and the first move after a touch, so that the stylus leaves
the surface at once."""

MIN_MOVE_MM = 1e-3
"""Length in mm below which a move is treated as having no length."""

LIFT_OFF_MM = 3.0
"""Length in mm of the move along the surface normal that precedes the withdrawal if a path does not leave the surface
at once."""


@dataclass(frozen=True)
class TipLocation:
    """Location of the stylus tip relative to a ball, where a touch begins or ends.

    `direction` is the unit vector of the touch, towards the ball. The tip centre is `out_mm` away from the centre of
    `ball`, in the direction opposite to `direction`. `touching` is True if the tip is on the surface after a touch.
    """

    ball: int
    direction: Point
    out_mm: float
    touching: bool = False


def detour_corners(centre: Array, start: TipLocation, end: TipLocation, stylus_axis: Array) -> Array:
    """Return the corner of each of n paths that go from `start` to `end` round the ball at `centre` (3,).

    Each path has one corner; the array has the shape (n, 1, 3).
    """
    # Bisector of both outward directions, tilted back along the stylus by each of the setbacks.
    bisector = -np.array(start.direction) - np.array(end.direction)
    directions = bisector - np.outer(DETOUR_SETBACKS, stylus_axis)
    lengths = np.sqrt((directions * directions).sum(axis=1))
    aside = lengths > MIN_LATERAL_COMPONENT
    units = directions[aside] / lengths[aside, None]
    out_mm = max(start.out_mm, end.out_mm) * np.array(DETOUR_RADII)
    return np.asarray((centre + out_mm[:, None, None] * units).reshape(-1, 1, 3))


def rectangular_exit(first: Point, last: Point, start: TipLocation, frame: ProbeFrame, station_axis: int) -> Array:
    """Return the k corners of a path from `first` past the end of a bar artefact to `last`, as an array of shape (1, k,
    3).

    The tip first lifts off the surface if it touches the ball. It then moves back along the stylus to the plane of the
    farther end, then perpendicularly to the stylus and to the station axis (index `station_axis`), and then straight to
    `last`.
    """
    beside = point(np.array(first) - LIFT_OFF_MM * np.array(start.direction)) if start.touching else first
    back, over = list(beside), list(last)
    back[frame.axis] = over[frame.axis] = frame.sign * min(
        frame.sign * beside[frame.axis], frame.sign * last[frame.axis]
    )
    over[station_axis] = beside[station_axis]
    return np.array([[beside, back, over] if start.touching else [back, over]])


def lifting_off(first: Point, candidates: PathCandidates, start: TipLocation) -> PathCandidates:
    """Return those candidate paths from the point `first` whose first move leaves the ball's surface that the tip
    touches. If the tip at `start` touches no surface, all candidates are returned.

    A candidate whose first move has no length is dropped, because its second move might press against this surface.
    """
    if not start.touching:
        return candidates
    directions = candidates.corners[:, 0] - np.array(first)
    lengths = np.linalg.norm(directions, axis=1)
    away = -directions @ np.array(start.direction) >= MIN_LIFT_OFF_COSINE * lengths
    return candidates.select(away & (lengths > MIN_MOVE_MM))


def lifts_off(first: Point, last: Point, start: TipLocation) -> bool:
    """Return whether the straight path from `first` to `last` leaves the ball's surface that the tip touches at once.
    The result is True if the tip at `start` touches no surface."""
    length = math.dist(first, last)
    away = -sum((b - a) * along for a, b, along in zip(first, last, start.direction, strict=True))
    return not start.touching or (away >= MIN_LIFT_OFF_COSINE * length and length > MIN_MOVE_MM)
