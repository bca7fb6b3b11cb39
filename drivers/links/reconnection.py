"""Restoration of a lost link, and repetition of requests that may be repeated, within bounds of number and time."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import TypeVar

import structlog

from drivers.clock import Clock, Deadline
from drivers.errors import LinkError, LinkLost, LinkTimeout
from drivers.links.modbus_transport import DamagedFrame

FIRST_PAUSE_S = 0.2
LONGEST_PAUSE_S = 4.0

LINK_FAILURES = (LinkLost, LinkTimeout, DamagedFrame)
"""Errors after which the peer may answer again; any other error is an answer."""

T = TypeVar("T")

_log = structlog.get_logger("link")


class Reconnection:
    """Restoration of one link.

    After a failed request, the connection is opened again and the request repeated, at most `max_attempts` times within
    `max_s` seconds, with growing pauses. It is suspended while an axis moves: a link that is lost then must end the
    motion.
    """

    def __init__(self, clock: Clock, *, max_attempts: int, max_s: float, where: Mapping[str, str]) -> None:
        self._clock = clock
        self._max_attempts = max_attempts
        self._max_s = max_s
        self._where = where
        self._suspensions = 0
        self.count = 0
        """Number of interruptions of the link after which it was restored."""
        self.in_progress = False
        """True between the failure of a request and the restoration of the link."""
        self.verify: Callable[[], None] = _accept_any_peer
        """Function that is called after each opening and raises an error if the peer is not in the state in which it
        was left."""

    @contextmanager
    def suspended(self) -> Iterator[None]:
        """Do not restore the link during the `with` block."""
        self._suspensions += 1
        try:
            yield
        finally:
            self._suspensions -= 1

    @property
    def available(self) -> bool:
        """True if a lost link would be restored now; False also for a request that is made while it is being restored,
        from inside a sleep between two attempts."""
        return self._max_attempts > 0 and not self._suspensions and not self.in_progress

    def repeat(self, failure: LinkError, reopen: Callable[[], None], request: Callable[[], T]) -> T:
        """Open the link again and return the result of `request`; raise `failure` if this is not possible in time."""
        if not self.available:
            raise failure
        _log.warning("link interrupted", error=str(failure), **self._where)
        self.in_progress = True
        try:
            result, attempts = self._attempt(failure, reopen, request)
        finally:
            self.in_progress = False
        self.count += 1
        _log.warning("link restored", attempts=attempts, interruptions=self.count, **self._where)
        return result

    def _attempt(self, failure: LinkError, reopen: Callable[[], None], request: Callable[[], T]) -> tuple[T, int]:
        deadline, pause_s = Deadline.after(self._clock, self._max_s), FIRST_PAUSE_S
        attempt, last = 0, failure
        while attempt < self._max_attempts and not deadline.expired:
            attempt += 1
            self._clock.sleep(min(pause_s, deadline.remaining_s))
            pause_s = min(2.0 * pause_s, LONGEST_PAUSE_S)
            try:
                with self.suspended():
                    reopen()
                    self.verify()
                    return request(), attempt
            except LINK_FAILURES as again:
                last = again
        failure.add_note(f"{attempt} attempts to restore the link failed, the last one with: {last}")
        failure.hint = failure.hint or last.hint
        failure.message += f"; {attempt} attempts to restore the link failed"
        raise failure


def _accept_any_peer() -> None:
    """Default of `Reconnection.verify`."""
