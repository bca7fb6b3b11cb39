"""Clock of a resumed run. It shows the recorded times while recorded steps are replayed, and runs normally
afterwards."""

from __future__ import annotations

from drivers.clock import Clock


class ResumedClock:
    """Clock that gives the machine time of a run, in s, as if the run had not been interrupted.

    During the replay the clock returns recorded times, so that decisions that depend on time are repeated. After the
    replay it runs on from the time passed to the method `start_running`.
    """

    def __init__(self, inner: Clock, begun_s: float) -> None:
        self._inner = inner
        self._recorded_s: float | None = begun_s
        self._ahead_s = 0.0

    def now(self) -> float:
        return self._inner.now() + self._ahead_s if self._recorded_s is None else self._recorded_s

    def sleep(self, duration_s: float) -> None:
        self._inner.sleep(duration_s)

    def advance_to(self, instant_s: float) -> None:
        """Advance to `instant_s`, the time in s at which a recorded step finished. Do nothing after `start_running`."""
        if self._recorded_s is not None:
            self._recorded_s = max(self._recorded_s, instant_s)

    def start_running(self, at_least_s: float) -> None:
        """Let the clock run from now on, beginning at the last recorded time or at `at_least_s`, whichever is later.

        Only the first call has an effect.
        """
        if self._recorded_s is not None:
            self._ahead_s = max(self._recorded_s, at_least_s) - self._inner.now()
            self._recorded_s = None
