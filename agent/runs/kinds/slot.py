"""Slot of a night: the machine time that is available, and how much of it is left."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from agent.errors import PlanRefused
from agent.execution.steps import Plan, ReadClock, Step
from agent.planning.preflight import PreflightResult
from agent.runs.kinds.night_plan import VERIFICATION
from twin.units import S_PER_MIN


@dataclass(frozen=True)
class AvailableTime:
    """Available machine time: `minutes`, of which `reserve` minutes must remain unused."""

    minutes: float
    reserve: float

    def left(self, passed_minutes: float) -> float:
        """Return the minutes that are left when `passed_minutes` have passed."""
        return self.minutes - self.reserve - passed_minutes


@dataclass(frozen=True)
class Slot(AvailableTime):
    """Machine time available for a night (slot). `full_allowed` is True if a full calibration is permitted."""

    full_allowed: bool

    def holds(self, minutes: float) -> bool:
        return minutes + self.reserve <= self.minutes


@dataclass(frozen=True)
class RunningSlot:
    """Slot that began at the machine time `began_s`. `timetable` returns the preflight of the night; it is called on
    the machine only."""

    slot: Slot
    began_s: float
    timetable: Callable[[], PreflightResult]

    def left_minutes(self, key: str) -> Plan[float]:
        """Read the clock, and return the minutes that are left of the slot. `key` is the key of the step."""
        now_s: float = yield ReadClock(key)
        return self.slot.left((now_s - self.began_s) / S_PER_MIN)

    def needed_after(self, prefix: str) -> float:
        return minutes_after(self.timetable(), prefix)


def begin_slot(slot: Slot, timetable: Callable[[], PreflightResult]) -> Plan[RunningSlot]:
    """Read the clock at the beginning of a night."""
    began_s: float = yield ReadClock("night/begins")
    return RunningSlot(slot, began_s, timetable)


def minutes_after(timetable: PreflightResult, prefix: str) -> float:
    """Return the planned minutes from the last step whose key begins with `prefix` to the end of the night."""
    done = [seconds for key, seconds in timetable.timeline.items() if key.startswith(f"{prefix}/")]
    return (timetable.machine_seconds - max(done, default=0.0)) / S_PER_MIN


def too_late(slot: Slot, timetable: PreflightResult, following: Step, passed_minutes: float) -> PlanRefused | None:
    """Return an error if too little of the slot is left to resume a night, and None otherwise. The time of an
    interruption counts as part of the slot.

    The time left must suffice for the rest of the verification at the beginning of the run, because an incomplete
    verification is useless. `following` is the first step of the resumed run that moves the machine, and
    `passed_minutes` is the time since the run began.
    """
    at_s, left = timetable.timeline.get(following.key), slot.left(passed_minutes)
    needed = 0.0 if at_s is None else (timetable.machine_seconds - at_s) / S_PER_MIN
    needed -= minutes_after(timetable, VERIFICATION)
    if max(needed, 0.0) > left or left <= 0.0:
        return PlanRefused(
            f"the night cannot be resumed: {left:.1f} min are left of its slot of {slot.minutes:g} min, "
            f"the verification alone needs {max(needed, 0.0):.1f} min more",
            hint="wait for the next night; what was measured stays in the journal",
        )
    return None
