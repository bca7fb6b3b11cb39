"""Hold and abort: requested from any thread, noticed in the clock's sleeps and nowhere else."""

from __future__ import annotations

import threading
from collections.abc import Callable

from drivers.clock import Clock
from drivers.errors import Aborted

HOLD_POLL_S = 0.05


class Supervisor:
    """The small mailbox between those who may interrupt a run and the one thread that runs it.

    `check` is what a `WatchedClock` calls. `on_hold` and `on_resume` are the machine's feed hold; they run on
    the run's own thread, between two waits of a driver, never inside a transaction. `alive` is called at every
    check and while held: who watches over the run's thread sees by it that it has not hung.
    """

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self._abort_reason: str | None = None
        self._hold = threading.Event()
        self._lock = threading.Lock()
        self._shielded = False
        self._holding = False
        self.on_hold: Callable[[], None] = _nothing
        self.on_resume: Callable[[], None] = _nothing
        self.alive: Callable[[], None] = _nothing

    def request_abort(self, reason: str) -> None:
        """The first reason stays."""
        with self._lock:
            if self._abort_reason is None:
                self._abort_reason = reason

    def request_hold(self) -> None:
        self._hold.set()

    def request_resume(self) -> None:
        self._hold.clear()

    def check(self) -> None:
        """Raise `Aborted`, or block while held. Inert while shielded and while it is itself holding."""
        self.alive()
        if self._shielded or self._holding:
            return
        self._raise_if_aborted()
        if self._hold.is_set():
            self._wait_for_resume()

    def shield(self) -> None:
        """From here on the way out runs (retract, restore, close): it must not be interrupted again."""
        self._shielded = True

    def _wait_for_resume(self) -> None:
        self._holding = True
        try:
            self.on_hold()
            while self._hold.is_set():
                self.alive()
                self._raise_if_aborted()
                self._clock.sleep(HOLD_POLL_S)
            self.on_resume()
        finally:
            self._holding = False

    def _raise_if_aborted(self) -> None:
        if self._abort_reason is not None:
            raise Aborted(f"aborted: {self._abort_reason}")


def _nothing() -> None:
    """No machine to hold yet."""
