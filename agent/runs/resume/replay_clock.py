"""Clock of a resumed run: recorded instants during the replay, then running time."""

from __future__ import annotations

from drivers.clock import Clock


class ResumedClock:
    """Machine seconds of the run as if it had never been interrupted: decisions made by the clock are repeated by the
    recorded one, and the time lost in between counts."""

    def __init__(self, inner: Clock, begun_s: float) -> None:
        self._inner = inner
        self._recorded_s: float | None = begun_s
        self._ahead_s = 0.0

    def now(self) -> float:
        return self._inner.now() + self._ahead_s if self._recorded_s is None else self._recorded_s

    def sleep(self, duration_s: float) -> None:
        self._inner.sleep(duration_s)

    def advance_to(self, instant_s: float) -> None:
        """Advance to the instant at which a recorded step finished."""
        if self._recorded_s is not None:
            self._recorded_s = max(self._recorded_s, instant_s)

    def start_running(self, at_least_s: float) -> None:
        """Let time pass from now on, from no earlier than `at_least_s`. Only the first call has an effect."""
        if self._recorded_s is not None:
            self._ahead_s = max(self._recorded_s, at_least_s) - self._inner.now()
            self._recorded_s = None
