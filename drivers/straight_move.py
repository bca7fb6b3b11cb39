"""Duration of a straight move, distance of a point from its path, and limits of speed and acceleration along its
direction.

A caller that knows the duration can sleep until just before the end of the move.
"""

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
    """Return the duration in s of a straight move whose speed has a trapezoidal (or triangular) profile.

    No axis exceeds its own speed and acceleration.
    """
    length_mm = math.dist(start_mm, target_mm)
    if length_mm == 0.0:
        return 0.0
    speed, acceleration = _limits_along(start_mm, target_mm, feed_mm_per_s, rapid_mm_per_s, acceleration_mm_per_s2)
    # Accelerating to v and braking again takes v²/a of path: a shorter move has a triangular profile, t = 2 √(s/a).
    if length_mm < speed * speed / acceleration:
        return 2.0 * math.sqrt(length_mm / acceleration)
    # Trapezoidal profile: s/v at full speed, plus v/(2a) for each of the two ramps.
    return length_mm / speed + speed / acceleration


def touch_duration_s(
    start_mm: Sequence[float],
    target_mm: Sequence[float],
    trip_mm: float,
    *,
    feed_mm_per_s: float | None,
    rapid_mm_per_s: Sequence[float],
    acceleration_mm_per_s2: Sequence[float],
) -> float:
    """Return the duration in s of a touch from `start_mm` towards `target_mm` that trips after `trip_mm` and brakes to
    a standstill.

    The axes accelerate to the feed, unless the probe trips earlier, and no axis exceeds its own limits.
    """
    if trip_mm == 0.0 or math.dist(start_mm, target_mm) == 0.0:
        return 0.0
    speed, acceleration = _limits_along(start_mm, target_mm, feed_mm_per_s, rapid_mm_per_s, acceleration_mm_per_s2)
    # Reached within the path: v² = 2as. The ramp up takes v/a, the rest s/v - v/(2a), and braking v/a.
    speed = min(speed, math.sqrt(2.0 * acceleration * trip_mm))
    return trip_mm / speed + 1.5 * speed / acceleration


def _limits_along(
    start_mm: Sequence[float],
    target_mm: Sequence[float],
    feed_mm_per_s: float | None,
    rapid_mm_per_s: Sequence[float],
    acceleration_mm_per_s2: Sequence[float],
) -> tuple[float, float]:
    """Return the largest speed and acceleration on the straight line between two different points."""
    length_mm = math.dist(start_mm, target_mm)
    components = [abs(end - begin) / length_mm for begin, end in zip(start_mm, target_mm, strict=True)]
    speed = limit_along_direction(components, rapid_mm_per_s)
    acceleration = limit_along_direction(components, acceleration_mm_per_s2)
    return speed if feed_mm_per_s is None else min(speed, feed_mm_per_s), acceleration


def distance_to_segment_mm(point_mm: Vector, start_mm: Vector, end_mm: Vector) -> float:
    """Return the distance in mm of a point from the line segment between two other points, each of shape (3,)."""
    along = end_mm - start_mm
    square = float(along @ along)
    # Foot of the perpendicular, as a fraction of the segment: t = (p - a)·(b - a) / |b - a|², limited to 0 ... 1.
    fraction = float(np.clip((point_mm - start_mm) @ along / square, 0.0, 1.0)) if square else 0.0
    return float(np.linalg.norm(point_mm - start_mm - fraction * along))


def limit_along_direction(components: Sequence[float], per_axis: Sequence[float]) -> float:
    """Return the largest speed or acceleration along a direction that keeps every axis within its own limit.

    `components` are the absolute values of the components of the unit direction vector. The result is the smallest
    ratio of an axis limit to the component for the same axis.
    """
    return min(limit / part for part, limit in zip(components, per_axis, strict=True) if part > 0.0)
