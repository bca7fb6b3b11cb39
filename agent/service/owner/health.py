"""Monitor of the thread that carries out a run. systemd's watchdog is fed only while this thread is considered alive.

Every wait of a driver and every step reports a beat, that is, a sign that the thread is alive. While the machine can
move, the thread is considered hung after some seconds without a beat. While the thread computes (preflight,
identification, writing results after the final state), it reports no beats and is considered hung only after some
minutes. A resumed run computes the same again in the state RESUMING, at whose end the machine returns to its position.
Between runs the thread is never considered hung.
"""

from __future__ import annotations

from collections.abc import Callable

from agent.execution.states import RunState
from agent.service.allowed_requests import AT_REST

COMPUTING = frozenset({RunState.PREFLIGHT, RunState.IDENTIFYING})


class Health:
    """Monitor of the time since the last beat, that is, since the last sign of the run's thread that it is alive.

    `now` is a function that returns the time in s from a clock that is independent of the engine.
    """

    def __init__(self, now: Callable[[], float], *, hang_timeout_s: float, computing_s: float) -> None:
        self._now = now
        self._hung_after_s = hang_timeout_s
        self._computing_s = computing_s
        self._last_s = now()
        self._concluding = False
        self._returning = False

    def begin_run(self) -> None:
        """Start to monitor the thread of a run."""
        self._concluding = False
        self._returning = False
        self.beat()

    def begin_return(self) -> None:
        """Allow only the time of a machine that can move from now on, although the state is still RESUMING.

        The machine of a resumed run returns to the position at which the run was interrupted.
        """
        self._returning = True
        self.beat()

    def begin_conclusion(self) -> None:
        """Allow a longer time between the beats (signs that the run's thread is alive) from now on.

        The run has reached its final state, and nothing moves while its results are written.
        """
        self._concluding = True
        self.beat()

    def beat(self) -> None:
        self._last_s = self._now()

    def silent_s(self) -> float:
        return self._now() - self._last_s

    def alive(self, state: RunState) -> bool:
        if state in AT_REST:
            return True
        computing = state in COMPUTING or (state is RunState.RESUMING and not self._returning)
        allowed = self._computing_s if self._concluding or computing else self._hung_after_s
        return self.silent_s() <= allowed
