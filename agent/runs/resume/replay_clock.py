"""The clock of a run that is gone on with: recorded instants while it is replayed, then on from there."""

from __future__ import annotations

from drivers.clock import Clock


class ResumedClock:
    """Machine seconds of the run, as if it had never been broken off: what was decided by the clock is decided again
    by the recorded one, and the time lost in between counts."""

    def __init__(self, inner: Clock, begun_s: float) -> None:
        self._inner = inner
        self._recorded_s: float | None = begun_s
        self._ahead_s = 0.0

    def now(self) -> float:
        return self._inner.now() + self._ahead_s if self._recorded_s is None else self._recorded_s

    def sleep(self, duration_s: float) -> None:
        self._inner.sleep(duration_s)

    def replayed_to(self, instant_s: float) -> None:
        """A recorded step was finished then."""
        if self._recorded_s is not None:
            self._recorded_s = max(self._recorded_s, instant_s)

    def run_on(self, at_least_s: float) -> None:
        """From now on time passes; no earlier than `at_least_s`. Only the first call counts."""
        if self._recorded_s is not None:
            self._ahead_s = max(self._recorded_s, at_least_s) - self._inner.now()
            self._recorded_s = None
