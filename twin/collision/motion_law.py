"""Motion laws, which give the distance along a path as a function of time in closed form.

A law is a sequence of phases of constant acceleration. The distance can therefore be computed for any instant without a
simulation in time steps, and the end of the motion is known when the motion begins. The units are mm (or degrees) and
s.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from twin.arrays import Array
from twin.collision.geometry import Point
from twin.immutable import Immutable

_NO_TIME_S = 1e-300
"""Time shorter than that of any move; it replaces a zero divisor, so that the ramp of a move of zero length is 0."""


class Phase(NamedTuple):
    """Phase of a motion with constant acceleration. It begins at the instant `start_s`, at the distance `distance`
    along the path, and with the speed `speed`.

    Like `StraightPath`, it is made for every move, and a tuple is made in a third of the time of a frozen dataclass.
    """

    start_s: float
    duration_s: float
    distance: float
    speed: float
    acceleration: float

    @property
    def end_s(self) -> float:
        return self.start_s + self.duration_s

    def distance_at(self, instant_s: float) -> float:
        t = min(max(instant_s - self.start_s, 0.0), self.duration_s)
        return self.distance + t * (self.speed + 0.5 * self.acceleration * t)

    def speed_at(self, instant_s: float) -> float:
        t = min(max(instant_s - self.start_s, 0.0), self.duration_s)
        return self.speed + self.acceleration * t

    def time_at(self, distance: float) -> float:
        """Return the first instant at which the motion reaches `distance`. The distance must be within this phase.

        The instant is computed from 2s / (v + √(v² + 2as)), which avoids cancellation. Here s is the distance from the
        start of the phase, v is the speed at the start, and a is the acceleration.
        """
        left = max(distance - self.distance, 0.0)
        root = math.sqrt(max(self.speed**2 + 2.0 * self.acceleration * left, 0.0))
        denominator = self.speed + root
        return self.start_s + (min(2.0 * left / denominator, self.duration_s) if denominator > 0.0 else 0.0)


@dataclass(frozen=True)
class MotionLaw(Immutable):
    """Distance along a path as a function of time. The motion is at rest before the first phase and after the last
    phase.
    """

    phases: tuple[Phase, ...]

    @property
    def start_s(self) -> float:
        return self.phases[0].start_s

    @property
    def end_s(self) -> float:
        return self.phases[-1].end_s

    @property
    def end_distance(self) -> float:
        last = self.phases[-1]
        return last.distance_at(last.end_s)

    def distance_at(self, instant_s: float) -> float:
        return self._phase_at(instant_s).distance_at(instant_s)

    def speed_at(self, instant_s: float) -> float:
        return self._phase_at(instant_s).speed_at(instant_s)

    def time_at(self, distance: float) -> float:
        """Return the first instant at which the motion reaches `distance`. If the motion never reaches it, return the
        instant at which the motion ends.
        """
        for phase in self.phases:
            if distance <= phase.distance_at(phase.end_s):
                return phase.time_at(distance)
        return self.end_s

    def truncated_at(self, instant_s: float) -> MotionLaw:
        """Return a motion law that equals this law until `instant_s`, at which the motion stops abruptly, as in a
        collision.
        """
        kept = self._until(instant_s)
        return MotionLaw(kept or (Phase(instant_s, 0.0, self.distance_at(instant_s), 0.0, 0.0),))

    def braked_from(self, instant_s: float, deceleration: float) -> MotionLaw:
        """Return a motion law that equals this law until `instant_s` and then decelerates to rest."""
        speed = self.speed_at(instant_s)
        brake = Phase(instant_s, speed / deceleration, self.distance_at(instant_s), speed, -deceleration)
        return MotionLaw((*self._until(instant_s), brake))

    def _until(self, instant_s: float) -> tuple[Phase, ...]:
        return tuple(
            Phase(
                phase.start_s,
                min(phase.duration_s, instant_s - phase.start_s),
                phase.distance,
                phase.speed,
                phase.acceleration,
            )
            for phase in self.phases
            if phase.start_s < instant_s
        )

    def _phase_at(self, instant_s: float) -> Phase:
        for phase in self.phases:
            if instant_s < phase.end_s:
                return phase
        return self.phases[-1]


def trapezoid(start_s: float, length: float, speed: float, acceleration: float) -> MotionLaw:
    """Return the motion law (distance as a function of time) of a motion from rest to rest over the distance `length`,
    with a trapezoidal speed profile.

    The speed profile is triangular if the distance is too short to reach `speed`.
    """
    top, ramp_s, cruise_s = _ramp_and_cruise(length, speed, acceleration)
    # distance of one ramp: v² / 2a
    # In a triangular profile the ramps meet: top² / a = length, and the time at top speed is 0.
    ramp = 0.5 * top * top / acceleration
    return MotionLaw(
        (
            Phase(start_s, ramp_s, 0.0, 0.0, acceleration),
            Phase(start_s + ramp_s, cruise_s, ramp, top, 0.0),
            Phase(start_s + ramp_s + cruise_s, ramp_s, length - ramp, top, -acceleration),
        )
    )


def travel_time_s(length: float, speed: float, acceleration: float) -> float:
    """Return the duration in s of a motion from rest to rest, over the distance `length`, with the trapezoidal or
    triangular speed profile that the function `trapezoid` describes.
    """
    _, ramp_s, cruise_s = _ramp_and_cruise(length, speed, acceleration)
    return ramp_s + cruise_s + ramp_s


def travel_times(
    starts: Array, ends: Array, speed_per_axis: Sequence[float], acceleration_per_axis: Sequence[float]
) -> Array:
    """Return the durations in s of straight moves from rest to rest, from `starts` (..., 3) to `ends` (..., 3) in mm.

    The result has the shape of the inputs without the last dimension. Every axis stays within its own limits of speed
    and acceleration. The durations equal those that the functions `straight_path` and `travel_time_s` give for each
    move.
    """
    lengths = np.abs(np.asarray(ends, dtype=np.float64) - starts)
    # L / a (in s²) and L / v (in s) of the limiting axis: with a = L / accelerating and v = L / cruising along the path
    accelerating = _largest(lengths / np.asarray(acceleration_per_axis))
    cruising = _largest(lengths / np.asarray(speed_per_axis))
    reached = np.sqrt(accelerating)
    # A ramp lasts v / a. Triangle if √(L / a) <= v / a: 2 √(L / a); trapezoid otherwise: L / v + v / a.
    ramp = accelerating / np.maximum(cruising, _NO_TIME_S)
    return np.asarray(np.where(reached <= ramp, 2.0 * reached, cruising + ramp))


def _largest(per_axis: Array) -> Array:
    """Return the maximum over the last axis of an array (..., 3).

    It compares whole columns, which is faster than a reduction over groups of three numbers.
    """
    return np.asarray(np.maximum(np.maximum(per_axis[..., 0], per_axis[..., 1]), per_axis[..., 2]))


def _ramp_and_cruise(length: float, speed: float, acceleration: float) -> tuple[float, float, float]:
    """Return the top speed, the duration of one ramp in s and the duration at top speed in s."""
    top = min(speed, math.sqrt(acceleration * length))
    cruise_s = max(length - top * top / acceleration, 0.0) / top if top > 0.0 else 0.0
    return top, top / acceleration, cruise_s


class StraightPath(NamedTuple):
    """Straight line from one set of axis positions to another. `direction` is a unit vector."""

    start: Point
    direction: Point
    length: float

    def at(self, distance: float) -> Point:
        start, direction = self.start, self.direction
        return (
            start[0] + distance * direction[0],
            start[1] + distance * direction[1],
            start[2] + distance * direction[2],
        )

    def limit_along(self, per_axis: Sequence[float]) -> float:
        """Return the largest speed (or acceleration) along the path for which no axis exceeds its own limit in
        `per_axis`.
        """
        largest = math.inf
        for limit, part in zip(per_axis, self.direction, strict=True):
            if part != 0.0 and limit < largest * abs(part):
                largest = limit / abs(part)
        return largest if largest < math.inf else min(per_axis)


def straight_path(start: Point, target: Point) -> StraightPath:
    """Return the straight path from `start` to `target`. If the two coincide, the length and the direction are zero."""
    x, y, z = target[0] - start[0], target[1] - start[1], target[2] - start[2]
    length = math.sqrt(x * x + y * y + z * z)
    if length == 0.0:
        return StraightPath(start, (0.0, 0.0, 0.0), 0.0)
    return StraightPath(start, (x / length, y / length, z / length), length)


def entry_distance(tip: Point, path: StraightPath, centre: Point, reach: float) -> float | None:
    """Return the distance along `path` at which a tip that starts at `tip` first comes within `reach` of the point
    `centre`.

    Return None if the tip is already within `reach` at the start, or never comes within `reach`.
    """
    # |m + s d|² = reach²: s² + 2 (m·d) s + (m² - reach²) = 0; the first root, in the form without cancellation
    mx, my, mz = tip[0] - centre[0], tip[1] - centre[1], tip[2] - centre[2]
    dx, dy, dz = path.direction
    closing = mx * dx + my * dy + mz * dz
    if closing >= 0.0:
        return None
    outside = mx * mx + my * my + mz * mz - reach * reach
    discriminant = closing * closing - outside
    if outside < 0.0 or discriminant < 0.0:
        return None
    distance = outside / (math.sqrt(discriminant) - closing)
    return distance if distance <= path.length else None
