"""Clocks, passed to their users as arguments. No other module of the project imports `time`.

The step engine and the drivers wait only by `clock.sleep` under a `Deadline`. Holds and aborts are detected in
that sleep, so every wait reacts to them.
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
"""Longest machine time in s until a hold or an abort is detected; the agent's design requires 50 ms."""


class Clock(Protocol):
    """Clock of machine time, in seconds since an arbitrary start; the time never decreases."""

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
    """Clock that runs `factor` times as fast as the wall clock."""

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
    """Clock that advances only by `sleep` and `advance_to`.

    Listeners (a simulated world, wire servers) are called after every advance.
    """

    def __init__(self) -> None:
        self._now = 0.0
        self._listeners: list[Callable[[float], None]] = []

    def subscribe(self, listener: Callable[[float], None]) -> None:
        """Register `listener`; it is called with the current time after every advance."""
        self._listeners.append(listener)

    def now(self) -> float:
        return self._now

    def sleep(self, duration_s: float) -> None:
        """Advance by `duration_s`, at least to the next float64.

        A shorter advance would be lost by rounding, and a loop that waits for an instant would never end.
        """
        if duration_s > 0.0:
            self.advance_to(max(self._now + duration_s, math.nextafter(self._now, math.inf)))

    def advance_to(self, instant_s: float) -> None:
        if instant_s <= self._now:
            return
        self._now = instant_s
        for listener in self._listeners:
            listener(instant_s)


class LockstepClock:
    """Virtual time shared with a simulator process: a sleep on this clock advances the simulated world.

    The agent's side is the master. A request is the line ``advance T\\n``, with T the clock's new time in s since its
    start; the peer answers ``ok\\n`` once the simulated world has reached that time. The clock is not a device and
    raises no fault: if the peer is lost, time continues with the wall clock, so that the machine's own link reports
    the loss.
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
    """Clock that splits every sleep into slices, so that `check` runs at least every `slice_s` of machine time.

    `check` raises to abort, or blocks while the run is held. Time on hold does not count: deadlines
    created with this clock do not expire during a hold.
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
        remaining_s = duration_s
        while remaining_s > 0.0:
            part_s = min(remaining_s, self._slice_s)
            self._inner.sleep(part_s)
            remaining_s -= part_s
            self._run_check()

    @property
    def inner(self) -> Clock:
        return self._inner

    def _run_check(self) -> None:
        before = self._inner.now()
        self._check()
        self._held_s += self._inner.now() - before


def without_interrupts(clock: Clock) -> Clock:
    """Return the clock beneath an `InterruptibleClock`, or `clock` itself.

    Use it for waits between a request and its answer. Such a wait must not be interrupted, and hold and STOP themselves
    send requests while the run is interrupted.
    """
    return clock.inner if isinstance(clock, InterruptibleClock) else clock


@dataclass(frozen=True)
class Deadline:
    """Instant on a given clock by which an awaited event must occur."""

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
        """Raise `DeadlineExpired` if the deadline has passed; its message contains `awaited`, the awaited event."""
        if self.expired:
            raise DeadlineExpired(f"timed out waiting for {awaited}", hint=hint, **where)


def wall_seconds() -> float:
    """Return a monotonic wall-clock time in s. It times the agent itself and must not be used as machine time."""
    return time.perf_counter()


def utc_timestamp() -> str:
    """Return the current UTC time for records, in ISO 8601 format to the millisecond."""
    seconds = time.time()
    stamp = time.strftime("%Y-%m-%dT%H:%M:%S", time.gmtime(seconds))
    return f"{stamp}.{int(seconds * 1e3) % 1000:03d}Z"
