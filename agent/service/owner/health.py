"""Health of the run's thread, on which systemd's watchdog depends.

Every wait of a driver and every step gives a beat. While something can move, silence is a hang after seconds; while
the thread computes (preflight, identification, the report of a run that has ended) there are no beats, and silence is a
hang after minutes. Between runs nothing can hang.
"""

from __future__ import annotations

from collections.abc import Callable

from agent.execution.states import RunState
from agent.service.allowed_requests import AT_REST

COMPUTING = frozenset({RunState.PREFLIGHT, RunState.IDENTIFYING})


class Health:
    """Beats of the run's thread. `now`: seconds of a clock that does not depend on the engine."""

    def __init__(self, now: Callable[[], float], *, hang_timeout_s: float, computing_s: float) -> None:
        self._now = now
        self._hung_after_s = hang_timeout_s
        self._computing_s = computing_s
        self._last_s = now()
        self._concludes = False

    def begins(self) -> None:
        """Note the begin of a run."""
        self._concludes = False
        self.beat()

    def concludes(self) -> None:
        """Note the run's final state: nothing moves any more, its results are being written."""
        self._concludes = True
        self.beat()

    def beat(self) -> None:
        self._last_s = self._now()

    def silent_s(self) -> float:
        return self._now() - self._last_s

    def alive(self, state: RunState) -> bool:
        if state in AT_REST:
            return True
        allowed = self._computing_s if self._concludes or state in COMPUTING else self._hung_after_s
        return self.silent_s() <= allowed
