"""One run of the service, from the moment it is reserved: what others ask of it before and while it goes on."""

from __future__ import annotations

import threading
from collections.abc import Callable

from agent.execution.supervisor import Supervisor


class Running:
    """The mailbox into a run. What is asked before its supervisor exists is handed over when it does."""

    def __init__(self, run_id: str, alive: Callable[[], None]) -> None:
        self.run_id = run_id
        self._alive = alive
        self._lock = threading.Lock()
        self._supervisor: Supervisor | None = None
        self._wanted: Callable[[Supervisor], None] | None = None

    def attach(self, supervisor: Supervisor) -> None:
        """What `agent.runs.session` calls when the run has its supervisor."""
        with self._lock:
            supervisor.alive = self._alive
            self._supervisor = supervisor
            if self._wanted is not None:
                self._wanted(supervisor)

    def abort(self, reason: str) -> None:
        """Somebody wants it to end. The first reason stays."""
        self._end(lambda supervisor: supervisor.request_abort(reason))

    def interrupt(self, reason: str) -> None:
        """The service must end; the run can be gone on with. The first reason stays."""
        self._end(lambda supervisor: supervisor.request_interruption(reason))

    def _end(self, wanted: Callable[[Supervisor], None]) -> None:
        with self._lock:
            self._wanted = self._wanted or wanted
            if self._supervisor is not None:
                self._wanted(self._supervisor)

    def hold(self) -> None:
        with self._lock:
            if self._supervisor is not None:
                self._supervisor.request_hold()

    def resume(self) -> None:
        with self._lock:
            if self._supervisor is not None:
                self._supervisor.request_resume()
