"""Events along a motion, computed when the motion begins, and the motion law that results from these events.

A motion law is the distance along the path as a function of time.
"""

from __future__ import annotations

from enum import Enum
from typing import NamedTuple

from twin.collision.bodies import TIP
from twin.collision.geometry import Point
from twin.collision.motion_law import MotionLaw, StraightPath


class MoveKind(Enum):
    POSITIONING = "positioning move"
    GUARDED = "guarded move"
    TOUCH = "touch"


class MotionCommand(NamedTuple):
    """Motion as commanded: its kind, its target and its straight path.

    `speed` is the speed along the path in mm/s, already limited to the highest speed that the axes can reach.
    """

    kind: MoveKind
    target: Point
    path: StraightPath
    speed: float
    acceleration: float


class Crash(NamedTuple):
    """Collision of the bodies `moving` and `obstacle` after `distance` mm of the path."""

    distance: float
    moving: str
    obstacle: str


class PathEvents(NamedTuple):
    """Events along the path of a motion command; all distances are measured along the path in mm.

    The probe trips at the distance `trip_mm`, or never if `trip_mm` is None. `crash` is the first collision that would
    happen if the motion continued, or None if there is no collision. A probe that is deflected at the start loses
    contact at the distance `free_mm`, which is 0 if the probe is not deflected at the start.
    """

    trip_mm: float | None = None
    crash: Crash | None = None
    free_mm: float = 0.0


class MotionForecast(NamedTuple):
    """Motion law (distance along the path as a function of time) that the axes will follow, and its events.

    `trip_s` is the instant in s at which the probe trips, or None. `free_s` is the instant at which an initially
    deflected probe loses contact. `end_s` is the end of the motion.
    """

    law: MotionLaw
    trip_s: float | None
    crash: Crash | None
    free_s: float
    end_s: float


def forecast_motion(law: MotionLaw, events: PathEvents, deceleration: float) -> MotionForecast:
    """Return the forecast of a motion that follows the motion law `law` until one of `events` changes the motion.

    The motion brakes with `deceleration` in mm/s² when the probe trips, and it ends abruptly at a collision.
    """
    trip_s = None
    if events.trip_mm is not None and events.trip_mm <= law.end_distance:
        trip_s = law.time_at(events.trip_mm)
        # The trip shortens the path first: a collision beyond the braked end does not happen.
        law = law.braked_from(trip_s, deceleration)
    crash = events.crash if events.crash and events.crash.distance <= law.end_distance else None
    if crash is not None:
        law = law.truncated_at(law.time_at(crash.distance))
    free_s = law.time_at(events.free_mm) if events.free_mm > 0.0 else law.start_s
    return MotionForecast(law, trip_s, crash, free_s, law.end_s)


def earliest(*crashes: Crash | None) -> Crash | None:
    met = [crash for crash in crashes if crash is not None]
    return min(met, key=lambda crash: crash.distance, default=None)


def tip_crash(ball: str, distance: float) -> Crash:
    return Crash(distance, TIP, ball)
