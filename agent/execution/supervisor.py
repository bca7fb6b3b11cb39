"""Requests to hold (pause), resume or abort a run. Any thread may make a request.

A request takes effect on the thread of the run, either while this thread waits on the clock or in a computation that
checks for requests.
"""

from __future__ import annotations

import threading
from collections.abc import Callable

from agent.errors import Aborted, Interrupted
from drivers.clock import Clock
from drivers.errors import VolcalError

HOLD_POLL_S = 0.05


class Supervisor:
    """Receiver of requests to hold, resume or end a run. Any thread may make a request; the thread of the run responds
    to it.

    The clock of the run (an `InterruptibleClock`) calls the method `check` during its waits. The callback `may_hold`
    returns True if the run can be held in its present state; a hold that was requested before waits for such a state,
    since nobody could resume the run in another one. The callback `on_hold` starts the machine's feed hold, and
    `on_resume` ends it. Before it ends, `before_resume` may wait until the machine can be resumed; a hold that is
    requested again during this wait goes on. All of them are called on the thread of the run while it waits on the
    clock, and never while a driver exchanges a message with a device.

    The callback `heartbeat` is called at every check and repeatedly during a hold. From these calls, a watchdog can see
    that the thread of the run does not hang.
    """

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self._stop_request: tuple[type[VolcalError], str] | None = None
        self._hold = threading.Event()
        self._lock = threading.RLock()  # a signal may come while its thread handles another one
        self._shielded = False
        self._holding = False
        self.may_hold: Callable[[], bool] = _always
        self.on_hold: Callable[[], None] = _do_nothing
        self.before_resume: Callable[[], None] = _do_nothing
        self.on_resume: Callable[[], None] = _do_nothing
        self.heartbeat: Callable[[], None] = _do_nothing

    def request_abort(self, reason: str) -> None:
        """Request the abort of the run.

        If the end of the run has already been requested, the earlier request and its reason remain valid.
        """
        self._request_stop(Aborted, f"aborted: {reason}")

    def request_interruption(self, reason: str) -> None:
        """Request the end of the run because the program must end. Unlike an aborted run, an interrupted run can be
        resumed.

        If the end of the run has already been requested, the earlier request and its reason remain valid.
        """
        self._request_stop(Interrupted, f"interrupted: {reason}")

    def _request_stop(self, kind: type[VolcalError], text: str) -> None:
        with self._lock:
            self._stop_request = self._stop_request or (kind, text)

    @property
    def stop_requested(self) -> bool:
        """True if the end of the run has been requested, also after a call of `shield`."""
        return self._stop_request is not None

    def request_hold(self) -> None:
        self._hold.set()

    def request_resume(self) -> None:
        self._hold.clear()

    def check(self) -> None:
        """Raise `Aborted` or `Interrupted` if the end of the run has been requested. If a hold (pause) of the run has
        been requested and the run can be held in its present state, wait until the run is resumed.

        Requests are ignored after a call of `shield`, or if this method is called during a hold. The callback
        `heartbeat` is called in every case.
        """
        self.heartbeat()
        if self._shielded or self._holding:
            return
        if self._stop_request is not None:
            self._raise_stop_request()
        if self._hold.is_set() and self.may_hold():
            self._wait_for_resume()

    def check_stop_request(self) -> None:
        """Raise `Aborted` or `Interrupted` if the end of the run has been requested, and ignore a request to hold.

        Computations call this method, because the machine does not move during a computation and need not be held.
        Requests are ignored after a call of `shield`.
        """
        self.heartbeat()
        if not self._shielded:
            self._raise_stop_request()

    def shield(self) -> None:
        """Ignore all requests from now on.

        The actions at the end of a run (retract the probe, restore the table, close the devices) must not be
        interrupted.
        """
        self._shielded = True

    def _wait_for_resume(self) -> None:
        self._holding = True
        try:
            self.on_hold()
            released = False
            while not released:
                while self._hold.is_set():
                    self.heartbeat()
                    self._raise_stop_request()
                    self._clock.sleep(HOLD_POLL_S)
                self.before_resume()
                released = not self._hold.is_set()
            self.on_resume()
        finally:
            self._holding = False

    def _raise_stop_request(self) -> None:
        if self._stop_request is not None:
            kind, text = self._stop_request
            raise kind(text)


def _always() -> bool:
    """Default callback if there are no states: the run can always be held."""
    return True


def _do_nothing() -> None:
    """Default callback if there is no machine to hold or no watchdog."""
