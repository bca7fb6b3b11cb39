"""Progress of a run, determined from its steps."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

from agent.execution.engine import Observer
from agent.execution.rig import Rig
from agent.execution.run_state import RunStateTracker
from agent.execution.steps import Record, Step, TouchTowards
from agent.planning.run_phases import PREFLIGHT, Progress
from agent.results.run_time import RunTime
from agent.runs.run_forecast import RunForecast
from agent.runs.run_results import RunResults
from drivers.clock import wall_seconds
from twin.units import S_PER_MIN

_SIMULATED_STEPS = 200
"""Number of simulated steps after which the preflight announces its progress: a fraction of a second."""
_LARGEST_FRACTION = 0.99
"""Largest announced fraction of a preflight that has not ended: the former one may have been shorter."""


@dataclass(frozen=True)
class FormerPreflight:
    """Number of steps that a preflight has simulated in all branches, and the time in s that the planning of its run
    has taken, as the note on the preflight in the journal states them."""

    STEPS: ClassVar[str] = "simulated_steps"
    SECONDS: ClassVar[str] = "planning_seconds"

    steps: int
    seconds: float

    @classmethod
    def of(cls, record: Mapping[str, Any]) -> FormerPreflight:
        return cls(int(record[cls.STEPS]), float(record[cls.SECONDS]))

    def as_record(self) -> dict[str, Any]:
        return {self.STEPS: self.steps, self.SECONDS: self.seconds}

    def fraction(self, steps: int) -> float | None:
        """Return the completed part of a preflight like this one after `steps` steps; None before the first step, when
        the positions are still being chosen."""
        return min(steps / self.steps, _LARGEST_FRACTION) if steps and self.steps else None


class StepProgress:
    """Observer of the steps of a run. It counts touches and balls, and announces the progress according to the forecast
    of the run, which follows the times of the steps."""

    def __init__(self, tracker: RunStateTracker, further: Observer, rig: Rig) -> None:
        """`further` is another observer; it receives every step before this one.

        Of the devices of the `rig`, interruptions of a link after which it was restored are noted, and what is impaired
        although the run goes on.
        """
        self._tracker = tracker
        self._rig = rig
        self._noted: Mapping[str, int] = {}
        self._impaired: set[tuple[str, str]] = set()
        self._further = further
        self._forecast: RunForecast | None = None
        self._last_s = 0.0
        self._announced: tuple[object, ...] = ()
        self._simulated_steps = 0
        self._simulating_since_s = wall_seconds()
        self.results = RunResults()
        self.touches = 0
        self.balls = 0

    def begin(self, forecast: RunForecast) -> None:
        """Follow the run with `forecast` from now on, and announce its minutes before its first step."""
        self._forecast, self._last_s = forecast, self._rig.clock.now()
        self._announce("", forecast.at_start())

    def simulating(self, watch: Callable[[], None], former: FormerPreflight | None) -> Callable[[], None]:
        """Return a function that the preflight calls after each simulated step. It calls `watch`, counts the steps and
        announces the progress of the preflight.

        `former` is the preflight of the last run of this kind; if it is None, neither the fraction nor the time left
        is known.
        """
        self._simulating_since_s = wall_seconds()

        def simulated() -> None:
            watch()
            self._simulated_steps += 1
            if self._simulated_steps % _SIMULATED_STEPS == 0:
                self._announce_preflight(former)

        self._announce_preflight(former)
        return simulated

    @property
    def preflight(self) -> FormerPreflight:
        """Preflight of this run until now, for the next run of its kind."""
        return FormerPreflight(self._simulated_steps, wall_seconds() - self._simulating_since_s)

    def run_time(self, minutes: float) -> RunTime | None:
        """Return the account of the time of a run that took `minutes`; None if it was not planned."""
        return None if self._forecast is None else self._forecast.run_time(minutes)

    def observe(self, step: Step, result: object) -> None:
        if self._forecast is not None:
            now_s = self._rig.clock.now()
            self._forecast.observe(step, result, now_s - self._last_s)
            self._last_s = now_s
        self.results.observe(step, result)
        self._further(step, result)
        self._note_interruptions()
        self._note_impairments()
        if isinstance(step, TouchTowards):
            self.touches += 1
        elif isinstance(step, Record):
            self._observe_record(step)
        if self._forecast is not None:
            self._announce(step.key, self._forecast.progress(step.key))

    def _note_interruptions(self) -> None:
        counts = self._rig.link_interruptions()
        for device, count in counts.items():
            if count > self._noted.get(device, 0):
                text = f"the link to {device} was interrupted while nothing moved, and restored ({count} so far)"
                self._tracker.note(text, device=device, interruptions=count)
        self._noted = counts

    def _note_impairments(self) -> None:
        impaired = {(device, text) for device, texts in self._rig.impairments().items() for text in texts}
        for device, text in sorted(impaired - self._impaired):
            self._tracker.note(f"{text}; the run goes on", device=device)
        for device, text in sorted(self._impaired - impaired):
            self._tracker.note(f"no longer: {text}", device=device)
        self._impaired = impaired

    def _observe_record(self, step: Record) -> None:
        if "note" in step.payload:
            self._tracker.announce_note(step.payload["note"])
        if step.kind == "ball":
            self.balls += 1

    def _announce_preflight(self, former: FormerPreflight | None) -> None:
        now = self.preflight
        self._tracker.progress(
            PREFLIGHT,
            phase=PREFLIGHT,
            fraction=0.0,
            minutes_left=None,
            phase_fraction=None if former is None else former.fraction(now.steps),
            phase_minutes_left=None if former is None else max(0.0, former.seconds - now.seconds) / S_PER_MIN,
            simulated_steps=now.steps,
        )

    def _announce(self, key: str, progress: Progress | None) -> None:
        """Announce the progress of the run and of its phase if one of its figures has changed as it is shown."""
        if progress is None:
            return
        shown = (
            progress.phase,
            round(1000.0 * progress.fraction),
            round(100.0 * progress.phase_fraction),
            math.ceil(progress.minutes_left),
        )
        if shown != self._announced:
            self._announced = shown
            self._tracker.progress(key, **vars(progress))
