"""Time, handed in. This is the only module of the house that imports `time`.

All waiting in plans' engine and in drivers is `clock.sleep` under a `Deadline`; a hold or an abort is
noticed there and nowhere else, so it is noticed everywhere.
"""

from __future__ import annotations

import contextlib
import math
import socket
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

from drivers.errors import DeadlineExpired

INTERRUPT_SLICE_S = 0.05
"""Longest machine time for which a hold or an abort goes unnoticed (agent design: 50 ms)."""


class Clock(Protocol):
    """Machine time in seconds since an arbitrary start; it never goes back."""

    def now(self) -> float: ...

    def sleep(self, duration_s: float) -> None: ...


class RealClock:
    """The wall clock."""

    def now(self) -> float:
        return time.monotonic()

    def sleep(self, duration_s: float) -> None:
        if duration_s > 0.0:
            time.sleep(duration_s)


class ScaledClock:
    """Runs `factor` times as fast as the wall clock."""

    def __init__(self, factor: float) -> None:
        if not factor > 0.0:
            raise ValueError(f"clock factor must be positive, got {factor}")
        self._factor = factor
        self._start = time.monotonic()

    def now(self) -> float:
        return (time.monotonic() - self._start) * self._factor

    def sleep(self, duration_s: float) -> None:
        if duration_s > 0.0:
            time.sleep(duration_s / self._factor)


class VirtualClock:
    """Sleeping is what makes time pass; listeners (a world, wire servers) are moved along with it."""

    def __init__(self) -> None:
        self._now = 0.0
        self._listeners: list[Callable[[float], None]] = []

    def subscribe(self, listener: Callable[[float], None]) -> None:
        """`listener(now)` is called after every advance."""
        self._listeners.append(listener)

    def now(self) -> float:
        return self._now

    def sleep(self, duration_s: float) -> None:
        """Time passes, however short the sleep: else who waits for an instant would wait for ever just before it."""
        if duration_s > 0.0:
            self.advance_to(max(self._now + duration_s, math.nextafter(self._now, math.inf)))

    def advance_to(self, instant_s: float) -> None:
        if instant_s <= self._now:
            return
        self._now = instant_s
        for listener in self._listeners:
            listener(instant_s)


class LockstepClock:
    """Virtual time shared with a simulator process: a sleep here is an advance there.

    The agent's side leads. One request is the line ``advance SECONDS\\n``, the answer ``ok\\n`` once the
    simulated world has reached that instant. The clock is no device and raises no fault: when the peer is
    gone, time runs on with the wall clock, so that the machine's own link reports the loss.
    """

    def __init__(self, host: str, port: int, *, answer_within_s: float = 10.0) -> None:
        self._socket: socket.socket | None = socket.create_connection((host, port), timeout=answer_within_s)
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._now = 0.0

    def now(self) -> float:
        return self._now

    def sleep(self, duration_s: float) -> None:
        if duration_s <= 0.0:
            return
        self._now += duration_s
        if self._socket is not None and not self._advance_peer():
            self.close()
        if self._socket is None:
            time.sleep(duration_s)

    def _advance_peer(self) -> bool:
        assert self._socket is not None  # noqa: S101  narrowed by the caller
        try:
            self._socket.sendall(b"advance %.9f\n" % self._now)
            answer = b""
            while not answer.endswith(b"\n"):
                chunk = self._socket.recv(16)
                if not chunk:
                    return False
                answer += chunk
        except OSError:
            return False
        return answer == b"ok\n"

    def close(self) -> None:
        if self._socket is not None:
            with contextlib.suppress(OSError):
                self._socket.close()
            self._socket = None


class InterruptibleClock:
    """A clock whose every sleep is sliced so that `check` runs at least each `slice_s` of machine time.

    `check` raises to abort, or blocks while the run is held. Time spent held does not count: deadlines
    made from this clock do not expire during a hold.
    """

    def __init__(self, inner: Clock, check: Callable[[], None], slice_s: float = INTERRUPT_SLICE_S) -> None:
        self._inner = inner
        self._check = check
        self._slice_s = slice_s
        self._held_s = 0.0

    def now(self) -> float:
        return self._inner.now() - self._held_s

    def sleep(self, duration_s: float) -> None:
        self._run_check()
        left = duration_s
        while left > 0.0:
            piece = min(left, self._slice_s)
            self._inner.sleep(piece)
            left -= piece
            self._run_check()

    @property
    def inner(self) -> Clock:
        return self._inner

    def _run_check(self) -> None:
        before = self._inner.now()
        self._check()
        self._held_s += self._inner.now() - before


def without_interrupts(clock: Clock) -> Clock:
    """The clock without its interruptions: for the moments within one request and its answer, which are never torn
    apart, and which a hold or a STOP itself needs while the run is interrupted."""
    return clock.inner if isinstance(clock, InterruptibleClock) else clock


@dataclass(frozen=True)
class Deadline:
    """The instant by which something must have happened."""

    clock: Clock
    expires_s: float

    @classmethod
    def after(cls, clock: Clock, duration_s: float) -> Deadline:
        return cls(clock, clock.now() + duration_s)

    @property
    def remaining_s(self) -> float:
        return max(0.0, self.expires_s - self.clock.now())

    @property
    def expired(self) -> bool:
        return self.clock.now() >= self.expires_s

    def raise_if_expired(self, awaited: str, *, hint: str = "", **where: str | int) -> None:
        """Raise `DeadlineExpired` naming what was awaited, if the instant has passed."""
        if self.expired:
            raise DeadlineExpired(f"timed out waiting for {awaited}", hint=hint, **where)


def wall_seconds() -> float:
    """Wall clock for figures about the agent itself, never for machine time."""
    return time.perf_counter()


def utc_timestamp() -> str:
    """Civil time for records: ISO 8601, UTC, to the millisecond."""
    seconds = time.time()
    stamp = time.strftime("%Y-%m-%dT%H:%M:%S", time.gmtime(seconds))
    return f"{stamp}.{int(seconds * 1e3) % 1000:03d}Z"
