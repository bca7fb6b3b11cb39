"""Runs that are dated in the future, because the clock of the computer that recorded them was wrong.

The history orders runs by their start. A run that is dated a year ahead would be the newest one for a year, and nothing
measured in this year would raise an alarm. Such a run keeps its place in lists, but it does not count in trends and
alarms, nor as the newest run.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta
from typing import Generic, Protocol, TypeVar

from agent.history.schema import utc_time

CLOCK_DIFFERENCE = timedelta(minutes=10)
"""Difference between the clocks of two computers up to which a run of one is not dated ahead for the other."""


class DatedRun(Protocol):
    """Run with its identity and its start, as the history stores them."""

    @property
    def run_id(self) -> str: ...

    @property
    def started(self) -> datetime: ...


R = TypeVar("R", bound=DatedRun)


@dataclass(frozen=True)
class RunsByDate(Generic[R]):
    """All runs (`every`), those that count (`counted`) and those that are dated in the future (`ahead`), each in the
    order of their start.

    If all runs are dated in the future, all of them count as well: the wrong clock may be that of this computer.
    """

    every: Sequence[R]
    counted: Sequence[R]
    ahead: Sequence[R]


def latest_start(now: datetime) -> datetime:
    """Return the latest start in UTC of a run that is not dated in the future at the time `now`."""
    return utc_time(now) + CLOCK_DIFFERENCE


def by_date(runs: Sequence[R], now: datetime) -> RunsByDate[R]:
    """Tell the runs that count at the time `now` from those that are dated in the future. `runs` are those of one
    machine, the oldest first."""
    latest = latest_start(now)
    ahead = [run for run in runs if utc_time(run.started) > latest]
    if not ahead or len(ahead) == len(runs):
        return RunsByDate(runs, runs, ahead)
    return RunsByDate(runs, [run for run in runs if utc_time(run.started) <= latest], ahead)


def ahead_text(ahead: Sequence[DatedRun]) -> str:
    """Return a sentence that names the last of the runs that are dated in the future, an empty text for no runs."""
    if not ahead:
        return ""
    last = ahead[-1].run_id
    if len(ahead) == 1:
        return f"run {last} is dated in the future: check the clock of the controller PC"
    return f"{len(ahead)} runs are dated in the future, the last is {last}: check the clock of the controller PC"
