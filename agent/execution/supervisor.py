"""Hold and abort of a run. Any thread may request them; they take effect on the run's thread, in waits of the clock
and in computations that check for them."""

from __future__ import annotations

import threading
from collections.abc import Callable

from agent.errors import Aborted, Interrupted
from drivers.clock import Clock
from drivers.errors import VolcalError

HOLD_POLL_S = 0.05


class Supervisor:
    """Mailbox for requests to hold, resume or end a run, from any thread to the thread of the run.

    An `InterruptibleClock` calls `check`. `on_hold` and `on_resume` start and end the machine's feed hold; they are
    called on the run's own thread between two waits of a driver, never during a transaction. `heartbeat` is called at
    every check and while held, so that a watchdog can see that the run's thread does not hang.
    """

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self._stop_request: tuple[type[VolcalError], str] | None = None
        self._hold = threading.Event()
        self._lock = threading.Lock()
        self._shielded = False
        self._holding = False
        self.on_hold: Callable[[], None] = _do_nothing
        self.on_resume: Callable[[], None] = _do_nothing
        self.heartbeat: Callable[[], None] = _do_nothing

    def request_abort(self, reason: str) -> None:
        """Request the end of the run. If a request is already pending, its reason is kept."""
        self._request_stop(Aborted, f"aborted: {reason}")

    def request_interruption(self, reason: str) -> None:
        """Request the end of the run because the program must end; unlike an aborted run, it can be resumed.

        If a request is already pending, its reason is kept.
        """
        self._request_stop(Interrupted, f"interrupted: {reason}")

    def _request_stop(self, kind: type[VolcalError], text: str) -> None:
        with self._lock:
            self._stop_request = self._stop_request or (kind, text)

    def request_hold(self) -> None:
        self._hold.set()

    def request_resume(self) -> None:
        self._hold.clear()

    def check(self) -> None:
        """Raise `Aborted` or `Interrupted` if an end is requested; block while held.

        If the supervisor is shielded, or if the hold itself calls this method, only the heartbeat is called.
        """
        self.heartbeat()
        if self._shielded or self._holding:
            return
        self._raise_stop_request()
        if self._hold.is_set():
            self._wait_for_resume()

    def check_stop_request(self) -> None:
        """Raise whatever `check` raises, but never block.

        Computations call this method, because nothing moves during them that could be held.
        """
        self.heartbeat()
        if not self._shielded:
            self._raise_stop_request()

    def shield(self) -> None:
        """Ignore all requests from now on, because the exit path (retract, restore, close) must not be interrupted."""
        self._shielded = True

    def _wait_for_resume(self) -> None:
        self._holding = True
        try:
            self.on_hold()
            while self._hold.is_set():
                self.heartbeat()
                self._raise_stop_request()
                self._clock.sleep(HOLD_POLL_S)
            self.on_resume()
        finally:
            self._holding = False

    def _raise_stop_request(self) -> None:
        if self._stop_request is not None:
            kind, text = self._stop_request
            raise kind(text)


def _do_nothing() -> None:
    """Default callback if there is no machine to hold or no watchdog."""
