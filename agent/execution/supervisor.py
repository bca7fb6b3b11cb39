"""Hold and abort: requested from any thread, noticed in the clock's sleeps and nowhere else."""

from __future__ import annotations

import threading
from collections.abc import Callable

from agent.errors import Aborted, Interrupted
from drivers.clock import Clock
from drivers.errors import VolcalError

HOLD_POLL_S = 0.05


class Supervisor:
    """The small mailbox between those who may interrupt a run and the one thread that runs it.

    `check` is what an `InterruptibleClock` calls. `on_hold` and `on_resume` are the machine's feed hold; they run on
    the run's own thread, between two waits of a driver, never inside a transaction. `alive` is called at every
    check and while held: who watches over the run's thread sees by it that it has not hung.
    """

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self._stop_request: tuple[type[VolcalError], str] | None = None
        self._hold = threading.Event()
        self._lock = threading.Lock()
        self._shielded = False
        self._holding = False
        self.on_hold: Callable[[], None] = _nothing
        self.on_resume: Callable[[], None] = _nothing
        self.heartbeat: Callable[[], None] = _nothing

    def request_abort(self, reason: str) -> None:
        """Somebody wants the run to end. The first reason stays."""
        self._request_stop(Aborted, f"aborted: {reason}")

    def request_interruption(self, reason: str) -> None:
        """The program must end; left as by an abort, but the run can be gone on with. The first reason stays."""
        self._request_stop(Interrupted, f"interrupted: {reason}")

    def _request_stop(self, kind: type[VolcalError], text: str) -> None:
        with self._lock:
            self._stop_request = self._stop_request or (kind, text)

    def request_hold(self) -> None:
        self._hold.set()

    def request_resume(self) -> None:
        self._hold.clear()

    def check(self) -> None:
        """Raise `Aborted` or `Interrupted`, or block while held. Inert while shielded and while itself holding."""
        self.heartbeat()
        if self._shielded or self._holding:
            return
        self._raise_stop_request()
        if self._hold.is_set():
            self._wait_for_resume()

    def check_stop_request(self) -> None:
        """While the run computes and nothing moves that could be held: raise as `check`."""
        self.heartbeat()
        if not self._shielded:
            self._raise_stop_request()

    def shield(self) -> None:
        """From here on the way out runs (retract, restore, close): it must not be interrupted again."""
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


def _nothing() -> None:
    """No machine to hold yet."""
