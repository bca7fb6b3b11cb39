"""Mailbox of one run of the service: requests to it, from the moment it is reserved until it has ended."""

from __future__ import annotations

import threading
from collections.abc import Callable

from agent.execution.supervisor import Supervisor


class RunMailbox:
    """Requests to one run. Those made before its supervisor exists are handed over when it does."""

    def __init__(self, run_id: str, alive: Callable[[], None]) -> None:
        self.run_id = run_id
        self._alive = alive
        self._lock = threading.Lock()
        self._supervisor: Supervisor | None = None
        self._wanted: Callable[[Supervisor], None] | None = None

    def attach(self, supervisor: Supervisor) -> None:
        """Connect the run's supervisor; the hook `agent.runs.run_context.RunHooks.attach`."""
        with self._lock:
            supervisor.heartbeat = self._alive
            self._supervisor = supervisor
            if self._wanted is not None:
                self._wanted(supervisor)

    def abort(self, reason: str) -> None:
        """Abort the run. The first reason stays."""
        self._end(lambda supervisor: supervisor.request_abort(reason))

    def interrupt(self, reason: str) -> None:
        """Interrupt the run because the service must end; it can be resumed. The first reason stays."""
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
