"""Model of the time that each step of a plan takes: the time of its motion plus the latency of its command.

The motion follows the motion law of `twin.collision.motion_law` within the machine's limits of speed and acceleration.
Moves are straight lines from rest to rest, and a touch brakes at the trip of the probe. The time that a controller
takes to start a command and to report its end is in no data sheet. It is modelled as one latency for each kind of
command.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from agent.execution.steps import AskOperator, MoveTo, OrientTo, Point, Step, TouchTowards
from agent.settings.schema import TimingSettings
from drivers.roles import OperatorTask
from twin.collision.motion_law import StraightPath, straight_path, trapezoid, travel_time_s
from twin.machine.machine_description import MachineDescription
from twin.units import S_PER_MIN


@dataclass(frozen=True)
class TimeModel:
    """Model of the time that the steps of a plan take.

    `rapid_mm_per_s` and `acceleration_mm_per_s2` are the limits of speed and acceleration of X, Y and Z from the
    machine file. The speed `turn_deg_per_s` and the acceleration `turn_deg_per_s2` apply to each axis of the mount, the
    rotary device that holds the artefact; both axes turn simultaneously. `command_latency_s`, `touch_latency_s` and
    `turn_latency_s` are added to the times of each move, touch and turn. The latency of a turn includes the time in
    which the mount settles. `carrying_s` is the time that the operator needs to put the artefact and the mount at
    another station, or to place the artefact by hand.
    """

    rapid_mm_per_s: Point
    acceleration_mm_per_s2: Point
    turn_deg_per_s: float
    turn_deg_per_s2: float
    command_latency_s: float = 0.0
    touch_latency_s: float = 0.0
    turn_latency_s: float = 0.0
    carrying_s: float = 0.0

    def move_s(self, start_mm: Point, target_mm: Point, feed_mm_per_s: float | None) -> float:
        """Return the time in s of a straight move from rest to rest, without the latency of the command. If
        `feed_mm_per_s` is None, the move is made at rapid traverse."""
        path = straight_path(start_mm, target_mm)
        speed = min(feed_mm_per_s or math.inf, path.limit_along(self.rapid_mm_per_s))
        return travel_time_s(path.length, speed, path.limit_along(self.acceleration_mm_per_s2))

    def touch_s(self, path: StraightPath, feed_mm_per_s: float, trip_mm: float | None) -> tuple[float, Point]:
        """Return the time in s of a touch along `path`, without the latency of the command, and the axis positions (3,)
        at the end of the touch.

        `trip_mm` is the distance along `path` at which the probe trips and the axes start to brake; it is None if the
        probe does not trip (a miss).
        """
        speed = min(feed_mm_per_s, path.limit_along(self.rapid_mm_per_s))
        acceleration = path.limit_along(self.acceleration_mm_per_s2)
        # The axes brake from the speed v at the trip: v/a longer and v²/2a farther.
        law = trapezoid(0.0, path.length, speed, acceleration)
        if trip_mm is None:
            return law.end_s, path.at(path.length)
        trip_s = law.time_at(trip_mm)
        speed = law.speed_at(trip_s)
        return trip_s + speed / acceleration, path.at(trip_mm + 0.5 * speed * speed / acceleration)

    def turn_s(self, start_deg: tuple[float, float], target_deg: tuple[float, float]) -> float:
        """Return the time in s that the mount of the artefact takes to turn from `start_deg` to `target_deg`, without
        the latency of the command. Both are pairs of azimuth and elevation; the two axes turn simultaneously."""
        angle_deg = max(abs(target - start) for start, target in zip(start_deg, target_deg, strict=True))
        return travel_time_s(angle_deg, self.turn_deg_per_s, self.turn_deg_per_s2)

    def overhead_s(self, step: Step) -> float:
        """Return the time in s that `step` takes in addition to its motion. This is the latency of a move, touch or
        turn, or the time in which the operator carries the artefact to another station; it is 0 for all other steps."""
        match step:
            case MoveTo():
                return self.command_latency_s
            case TouchTowards():
                return self.touch_latency_s
            case OrientTo():
                return self.turn_latency_s
            case AskOperator(request=request) if request.task is not OperatorTask.CONSENT:
                return self.carrying_s
        return 0.0


def takes_time(step: Step) -> bool:
    """Return True if `step` is of a kind that has a latency, even if the settings state none."""
    if isinstance(step, AskOperator):
        return step.request.task is not OperatorTask.CONSENT
    return isinstance(step, (MoveTo, TouchTowards, OrientTo))


def time_model(machine: MachineDescription, timing: TimingSettings) -> TimeModel:
    """Return the time model for `machine`. The limits of speed and acceleration of X, Y and Z come from the machine
    file, and all other values come from the section `timing` of the settings."""
    x, y, z = machine.rapid_mm_per_min
    return TimeModel(
        rapid_mm_per_s=(x / S_PER_MIN, y / S_PER_MIN, z / S_PER_MIN),
        acceleration_mm_per_s2=machine.acceleration_mm_per_s2,
        turn_deg_per_s=timing.speed_deg_per_s,
        turn_deg_per_s2=timing.acceleration_deg_per_s2,
        command_latency_s=timing.command_latency_s,
        touch_latency_s=timing.touch_latency_s,
        turn_latency_s=timing.turn_latency_s,
        carrying_s=timing.relocation_minutes * S_PER_MIN,
    )
