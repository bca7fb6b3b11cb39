"""Clocks, which are passed as arguments to the code that uses them. No other module of the project imports `time`.

The step engine (which carries out the steps of a run) and the drivers wait only by `clock.sleep` under a `Deadline`.
`clock.sleep` detects requests to hold or abort the run, so every wait reacts to them.
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
    """Clock of machine time (real time, or the time of a simulated machine) in seconds since an arbitrary start. The
    time never decreases.
    """

    def now(self) -> float: ...

    def sleep(self, duration_s: float) -> None: ...


class RealClock:
    """Clock whose time is the monotonic time of the computer."""

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
    """Clock whose time advances only by `sleep` and `advance_to`.

    Listeners, such as a simulated machine, are called after every advance.
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
        """Advance the time by `duration_s`, or to the next float64 number if `duration_s` would be lost by rounding.

        Without this minimum, a loop that waits for an instant could run for ever.
        """
        if duration_s > 0.0:
            instant_s = self._now + duration_s
            self.advance_to(instant_s if instant_s > self._now else math.nextafter(self._now, math.inf))

    def advance_to(self, instant_s: float) -> None:
        if instant_s <= self._now:
            return
        self._now = instant_s
        for listener in self._listeners:
            listener(instant_s)


class LockstepClock:
    """Clock with virtual time that is shared with a simulator process; a sleep on this clock advances the simulation.

    This clock sends the line ``advance T\\n``, where T is its new time in s since its start. The simulator answers
    ``ok\\n`` when its simulation has reached that time. If the simulator is lost, this class raises no error, because
    the clock is not a device. The clock then continues with the wall clock, and the link to the machine reports the
    loss.
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
    """Clock that splits every sleep into slices and calls `check` at least every `slice_s` of machine time.

    `check` raises an exception to abort the run, and blocks while the run is held (paused). The time of a hold is not
    counted: deadlines on this clock do not expire during a hold.
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
        sleep, slice_s, remaining_s = self._inner.sleep, self._slice_s, duration_s
        while remaining_s > 0.0:
            part_s = slice_s if remaining_s > slice_s else remaining_s
            sleep(part_s)
            remaining_s -= part_s
            self._run_check()

    @property
    def inner(self) -> Clock:
        return self._inner

    def _run_check(self) -> None:
        now = self._inner.now
        before = now()
        self._check()
        self._held_s += now() - before


def without_interrupts(clock: Clock) -> Clock:
    """Return the inner clock of an `InterruptibleClock` (whose sleeps can be interrupted), or any other clock
    unchanged.

    Use the returned clock for waits between a request to a device and its answer. These waits must not be interrupted,
    because the commands for hold and stop also send requests while the run is interrupted.
    """
    return clock.inner if isinstance(clock, InterruptibleClock) else clock


@dataclass(frozen=True)
class Deadline:
    """Time limit of a wait: the instant on a given clock by which the awaited event must occur."""

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
        """Raise `DeadlineExpired` if the deadline has passed.

        `awaited` names the event that has not occurred; it is part of the error message.
        """
        if self.expired:
            raise DeadlineExpired(f"timed out waiting for {awaited}", hint=hint, **where)


def wall_seconds() -> float:
    """Return the monotonic wall-clock time in s.

    Use it only to measure durations within the agent, not as machine time.
    """
    return time.perf_counter()


def utc_timestamp() -> str:
    """Return the current UTC time for records, in ISO 8601 format to the millisecond."""
    seconds = time.time()
    stamp = time.strftime("%Y-%m-%dT%H:%M:%S", time.gmtime(seconds))
    return f"{stamp}.{int(seconds * 1e3) % 1000:03d}Z"
