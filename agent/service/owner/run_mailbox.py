"""Mailbox for requests to one run of the service. It accepts requests from the moment at which the owner of the machine
is reserved for the run until the end of the run."""

from __future__ import annotations

import threading
from collections.abc import Callable

from agent.execution.supervisor import Supervisor


class RunMailbox:
    """Mailbox for requests to one run.

    A request to abort or interrupt the run may come before the run has a supervisor, which carries out such requests;
    the request is delivered when the supervisor is attached.
    """

    def __init__(self, run_id: str, alive: Callable[[], None]) -> None:
        self.run_id = run_id
        self._alive = alive
        self._lock = threading.Lock()
        self._supervisor: Supervisor | None = None
        self._end_request: Callable[[Supervisor], None] | None = None

    def attach(self, supervisor: Supervisor) -> None:
        """Connect the supervisor of the run with this mailbox. This method is passed to the run as the hook
        `agent.runs.run_context.RunHooks.attach`."""
        with self._lock:
            supervisor.heartbeat = self._alive
            self._supervisor = supervisor
            if self._end_request is not None:
                self._end_request(supervisor)

    def abort(self, reason: str) -> None:
        """Abort the run. If an earlier request has already aborted or interrupted it, that request and its reason
        remain in force."""
        self._end(lambda supervisor: supervisor.request_abort(reason))

    def interrupt(self, reason: str) -> None:
        """Interrupt the run because the service must stop; the run can be resumed.

        If an earlier request has already aborted or interrupted the run, that request and its reason remain in force.
        """
        self._end(lambda supervisor: supervisor.request_interruption(reason))

    def _end(self, end_request: Callable[[Supervisor], None]) -> None:
        with self._lock:
            self._end_request = self._end_request or end_request
            if self._supervisor is not None:
                self._end_request(self._supervisor)

    def hold(self) -> None:
        with self._lock:
            if self._supervisor is not None:
                self._supervisor.request_hold()

    def resume(self) -> None:
        with self._lock:
            if self._supervisor is not None:
                self._supervisor.request_resume()
