"""Events along a motion, computed when it begins, and the resulting motion law."""

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
    """Motion as commanded. `speed` is along the path in mm/s, already limited to what the axes can reach."""

    kind: MoveKind
    target: Point
    path: StraightPath
    speed: float
    acceleration: float


class Crash(NamedTuple):
    """Collision of two bodies after `distance` mm of path."""

    distance: float
    moving: str
    obstacle: str


class PathEvents(NamedTuple):
    """Events along the path of a command, with path distances in mm.

    `trip_mm`: distance at which the probe trips, or None; `crash`: first collision that would happen if the motion
    continued, or None; `free_mm`: distance at which a probe that is deflected at the start separates, 0 if it is not
    deflected.
    """

    trip_mm: float | None = None
    crash: Crash | None = None
    free_mm: float = 0.0


class MotionForecast(NamedTuple):
    """Motion law that will be executed, and the instants in s of the events along it."""

    law: MotionLaw
    trip_s: float | None
    crash: Crash | None
    free_s: float
    end_s: float


def forecast_motion(law: MotionLaw, events: PathEvents, deceleration: float) -> MotionForecast:
    """Return the forecast of a motion by `law`, which brakes when the probe trips and ends abruptly at a crash."""
    trip_s = None
    if events.trip_mm is not None and events.trip_mm <= law.end_distance:
        trip_s = law.time_at(events.trip_mm)
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
