"""The calendar of a fortnight that takes minutes: a file says which instant it is, machine time goes on from there."""

from __future__ import annotations

import time
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import drivers.clock
from agent.service.owner.unattended import Circumstances
from drivers.clock import LockstepClock

UP_MINUTES = 600.0


def turn_to(path: Path, instant: datetime) -> None:
    """From now on it is `instant`, for everybody who reads `path`."""
    new = path.with_suffix(".new")
    new.write_text(instant.isoformat(), encoding="utf-8")
    new.replace(path)


class Almanac:
    """Civil time of one process: what the file says, and the machine seconds that have passed here since it said so."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._said = ""
        self._machine_s = self._turned_s = 0.0

    def seconds(self) -> float:
        """Since 1970, UTC."""
        said = self._path.read_text(encoding="utf-8")
        if said != self._said:
            self._said, self._turned_s = said, self._machine_s
        return datetime.fromisoformat(said).timestamp() + self._machine_s - self._turned_s

    def circumstances(self) -> Circumstances:
        """The plant keeps UTC, and the computer at the machine is never switched off."""
        return Circumstances(datetime.fromtimestamp(self.seconds(), UTC), UP_MINUTES)

    def rule(self) -> None:
        """Every record of this process is dated by this calendar, and machine time moves it on."""
        drivers.clock.time = _CivilTime(self)  # type: ignore[attr-defined]
        sleep = LockstepClock.sleep

        def counted(clock: LockstepClock, duration_s: float) -> None:
            sleep(clock, duration_s)
            self._machine_s += max(duration_s, 0.0)

        LockstepClock.sleep = counted  # type: ignore[method-assign]


class _CivilTime:
    """The module `time` with another calendar; its other clocks are what they are."""

    def __init__(self, almanac: Almanac) -> None:
        self.time = almanac.seconds

    def __getattr__(self, name: str) -> Any:
        return getattr(time, name)
