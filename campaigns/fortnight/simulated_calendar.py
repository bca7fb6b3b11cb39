"""Simulated calendar for a fortnight that is simulated within minutes.

A file gives a date and time. From this instant the calendar advances with machine time.
"""

from __future__ import annotations

import time
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import drivers.clock
from agent.service.owner.unattended import Circumstances
from drivers.clock import LockstepClock

UP_MINUTES = 600.0


def set_calendar(path: Path, instant: datetime) -> None:
    """Write `instant` to the file `path`. All processes that read this file then use it as the present date
    and time.
    """
    new = path.with_suffix(".new")
    new.write_text(instant.isoformat(), encoding="utf-8")
    new.replace(path)


class SimulatedCalendar:
    """Civil time of one process.

    Civil time is the instant in the calendar file plus the machine time that has passed in this process since the file
    last changed.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._said = ""
        self._machine_s = self._turned_s = 0.0

    def seconds(self) -> float:
        """Return the present civil time in s since the beginning of 1970 (UTC)."""
        said = self._path.read_text(encoding="utf-8")
        if said != self._said:
            self._said, self._turned_s = said, self._machine_s
        return datetime.fromisoformat(said).timestamp() + self._machine_s - self._turned_s

    def circumstances(self) -> Circumstances:
        """Return the local time and the uptime of the controller PC.

        The simulated plant uses UTC, and the controller PC is assumed never to be switched off.
        """
        return Circumstances(datetime.fromtimestamp(self.seconds(), UTC), UP_MINUTES)

    def install(self) -> None:
        """Use this calendar for all timestamps of this process, and advance the calendar with machine time."""
        vars(drivers.clock)["time"] = _CivilTime(self)
        sleep = LockstepClock.sleep

        def counted(clock: LockstepClock, duration_s: float) -> None:
            sleep(clock, duration_s)
            self._machine_s += max(duration_s, 0.0)

        LockstepClock.sleep = counted  # type: ignore[method-assign,assignment]


class _CivilTime:
    """Replacement for module `time` with a different calendar; the other clocks of the module are unchanged."""

    def __init__(self, calendar_: SimulatedCalendar) -> None:
        self.time = calendar_.seconds

    def __getattr__(self, name: str) -> Any:
        return getattr(time, name)
