"""Whether the run's thread is alive: what feeds systemd's watchdog.

Every wait of a driver and every step gives a beat. Where something can move, silence is a hang after seconds; where
the thread computes (preflight, identification, the report of a run that has ended) it gives no beats, and is given
minutes. Between runs there is nothing that could hang.
"""

from __future__ import annotations

from collections.abc import Callable

from agent.execution.states import RunState
from agent.service.allowed_requests import AT_REST

COMPUTING = frozenset({RunState.PREFLIGHT, RunState.IDENTIFYING})


class Health:
    """`now`: seconds of a clock that runs on whatever the engine does."""

    def __init__(self, now: Callable[[], float], *, hang_timeout_s: float, computing_s: float) -> None:
        self._now = now
        self._hung_after_s = hang_timeout_s
        self._computing_s = computing_s
        self._last_s = now()
        self._concludes = False

    def begins(self) -> None:
        """A run, from now on."""
        self._concludes = False
        self.beat()

    def concludes(self) -> None:
        """The run is in its last state: nothing moves any more, its results are written."""
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
