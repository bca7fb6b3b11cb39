"""Conditions for starting a run without the consent of a person at the machine. They concern the time of day, the
warm-up and the permissions of the controller.

A timer only sends requests to start. Such a request is refused before anything moves if the time of day is not
permitted, if the machine has just been switched on, or if the controller does not permit motion. A refusal is not a
fault, so the next night is not affected.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta

from agent.errors import GateRefused
from drivers.errors import PermissionMissing
from drivers.roles import MachineStatus, MotionState
from twin.units import S_PER_MIN

MINUTES_A_DAY = 1440.0


@dataclass(frozen=True)
class Circumstances:
    """Time at which a run is to be started. `now` is the local time without a time zone, so that it is that of this
    computer, with its changes to and from summer time; `up_minutes` is the time in min since the computer at the
    machine was switched on."""

    now: datetime
    up_minutes: float


def require_warm(circumstances: Circumstances, warm_up_minutes: float) -> None:
    """Raise GateRefused if the machine has been on for less than `warm_up_minutes`."""
    missing = warm_up_minutes - circumstances.up_minutes
    if missing > 0.0:
        raise GateRefused(
            f"the machine has been on for {circumstances.up_minutes:.0f} min; warm-up takes {warm_up_minutes:g} min",
            hint=f"try again in {missing:.0f} min, or start manually with consent",
            key="service.warm_up_minutes",
        )


def minutes_until_end(circumstances: Circumstances, hours: Sequence[str]) -> float | None:
    """Return the time in min until the permitted hours end, or None if no hours are set. It is the time that passes
    until the clock shows their end, also in a night in which the clock is changed. Raise GateRefused if the present
    time is outside the permitted hours."""
    if not hours:
        return None
    now = 60.0 * circumstances.now.hour + circumstances.now.minute + circumstances.now.second / 60.0
    shown = [span - since for begins, span in map(_span, hours) if (since := (now - begins) % MINUTES_A_DAY) < span]
    left = [_minutes_that_pass(circumstances.now, minutes) for minutes in shown]
    if not left:
        raise GateRefused(
            f"it is {circumstances.now:%H:%M}; unattended runs may start only within {', '.join(hours)}",
            hint="start manually with consent, or change the permitted hours",
            key="service.hours",
        )
    return max(left)


def require_permission(status: MachineStatus) -> None:
    """Raise PermissionMissing if the machine has a fault or the controller does not permit motion."""
    if status.state is MotionState.FAULT:
        raise PermissionMissing(f"the machine has a fault: {status.fault}", hint="clear the fault at the machine")
    if status.missing:
        names = ", ".join(permission.value for permission in status.missing)
        raise PermissionMissing(f"the machine does not permit motion; missing: {names}", hint="nothing was moved")


def _minutes_that_pass(now: datetime, shown_minutes: float) -> float:
    """Return the time in min that passes while the local clock goes on from `now` by `shown_minutes`. If the clock
    shows that time twice, or leaves it out, the shorter of two answers is returned, but not a time before `now`."""
    shown = now + timedelta(minutes=shown_minutes)
    folds = (1,) if now.fold else (0, 1)
    seconds = min(shown.replace(fold=fold).timestamp() for fold in folds) - now.timestamp()
    return max(seconds, 0.0) / S_PER_MIN


def _span(text: str) -> tuple[float, float]:
    """Return the beginning and the length, both in min, of a time span such as `22:00-05:00`. Equal times mean the
    whole day.
    """
    begins, ends = (60.0 * int(t[:2]) + int(t[3:]) for t in text.split("-"))
    return begins, (ends - begins) % MINUTES_A_DAY or MINUTES_A_DAY
