"""Progress of a run, determined from its steps."""

from __future__ import annotations

from collections.abc import Mapping

from agent.execution.engine import Observer
from agent.execution.rig import Rig
from agent.execution.run_state import RunStateTracker
from agent.execution.steps import Record, Step, TouchTowards
from agent.results.run_time import RunTime
from agent.runs.run_forecast import RunForecast
from agent.runs.run_results import RunResults
from twin.units import S_PER_MIN


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
        self.results = RunResults()
        self.touches = 0
        self.balls = 0

    def begin(self, forecast: RunForecast) -> None:
        """Follow the run with `forecast` from now on."""
        self._forecast, self._last_s = forecast, self._rig.clock.now()

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
        if step.kind == "ball" and self._forecast is not None:
            self.balls += 1
            self._announce_progress(step.key, self._forecast)

    def _announce_progress(self, key: str, forecast: RunForecast) -> None:
        """Announce the fraction of machine time used and the minutes left. Both follow the latencies that the run has
        shown so far."""
        left_s, done_s = forecast.left_s(key), forecast.done_s(key)
        if left_s is not None and done_s is not None:
            fraction = done_s / (done_s + left_s)
            self._tracker.progress(key, fraction=fraction, minutes_left=left_s / S_PER_MIN)
