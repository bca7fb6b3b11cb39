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
        self._abort_reason: str | None = None

    def attach(self, supervisor: Supervisor) -> None:
        """What `agent.session` calls when the run has its supervisor."""
        with self._lock:
            supervisor.alive = self._alive
            self._supervisor = supervisor
            if self._abort_reason is not None:
                supervisor.request_abort(self._abort_reason)

    def abort(self, reason: str) -> None:
        """The first reason stays."""
        with self._lock:
            self._abort_reason = self._abort_reason or reason
            if self._supervisor is not None:
                self._supervisor.request_abort(self._abort_reason)

    def hold(self) -> None:
        with self._lock:
            if self._supervisor is not None:
                self._supervisor.request_hold()

    def resume(self) -> None:
        with self._lock:
            if self._supervisor is not None:
                self._supervisor.request_resume()
