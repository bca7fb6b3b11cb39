"""A straight move: how long it will take, so that a wait can sleep until just before its end, and what lies on it."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from drivers.roles import Vector


def move_duration_s(
    start_mm: Sequence[float],
    target_mm: Sequence[float],
    *,
    feed_mm_per_s: float | None,
    rapid_mm_per_s: Sequence[float],
    acceleration_mm_per_s2: Sequence[float],
) -> float:
    """Trapezoidal (or triangular) velocity along the line; no axis above its own speed and acceleration."""
    deltas = [abs(end - begin) for begin, end in zip(start_mm, target_mm, strict=True)]
    length_mm = math.sqrt(sum(delta * delta for delta in deltas))
    if length_mm == 0.0:
        return 0.0
    shares = [delta / length_mm for delta in deltas]
    speed = limit_along_direction(shares, rapid_mm_per_s)
    acceleration = limit_along_direction(shares, acceleration_mm_per_s2)
    if feed_mm_per_s is not None:
        speed = min(speed, feed_mm_per_s)
    if length_mm < speed * speed / acceleration:
        return 2.0 * math.sqrt(length_mm / acceleration)
    return length_mm / speed + speed / acceleration


def distance_to_segment_mm(point_mm: Vector, start_mm: Vector, end_mm: Vector) -> float:
    """Of a point, (3,), from the straight line between two others."""
    along = end_mm - start_mm
    square = float(along @ along)
    share = float(np.clip((point_mm - start_mm) @ along / square, 0.0, 1.0)) if square else 0.0
    return float(np.linalg.norm(point_mm - start_mm - share * along))


def limit_along_direction(shares: Sequence[float], per_axis: Sequence[float]) -> float:
    """The largest value along a line on which no axis exceeds its own; `shares`: |direction|, of unit length."""
    return min(limit / share for share, limit in zip(shares, per_axis, strict=True) if share > 0.0)
