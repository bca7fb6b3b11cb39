"""One simulated world with its lock, and the protocol servers and CAN nodes that advance with its time."""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass
from typing import Generic, Protocol, TypeVar


class TimeDriven(Protocol):
    """Interface of an object, such as a simulated world, whose machine time is advanced by its owner."""

    @property
    def now(self) -> float: ...

    def advance_to(self, instant_s: float) -> None: ...


W_co = TypeVar("W_co", bound=TimeDriven, covariant=True)


@dataclass(frozen=True)
class _Companion:
    on_advance: Callable[[float], None]
    wakes_at: Callable[[], float | None] | None


class SharedWorld(Generic[W_co]):
    """Simulated world with a lock that serialises access. Hold `lock` (re-entrant) while reading `world` or commanding
    it.

    Companions are objects that follow the world's time, such as a heartbeat monitor or CAN nodes. They are called after
    each advance, under the lock. If a companion must be called at a certain instant, its `wakes_at` returns this
    instant. An advance beyond this instant is made in two parts. A timeout of one second then expires after exactly one
    second, even if the clock jumps further.
    """

    def __init__(self, world: W_co) -> None:
        self._world = world
        self.lock = threading.RLock()
        self._companions: list[_Companion] = []

    @property
    def world(self) -> W_co:
        return self._world

    @property
    def now(self) -> float:
        """Machine time in s."""
        return self._world.now

    def subscribe(
        self, on_advance: Callable[[float], None], *, wakes_at: Callable[[], float | None] | None = None
    ) -> None:
        """Call `on_advance(now_s)` after each advance of the world.

        `wakes_at()` returns the next instant in s at which `on_advance` must be called, or None if there is no such
        instant.
        """
        with self.lock:
            self._companions.append(_Companion(on_advance, wakes_at))

    def advance_to(self, instant_s: float) -> None:
        """Advance the world, and the objects that follow its time, to the machine time `instant_s`. Does nothing if
        this instant has passed.
        """
        with self.lock:
            while self._world.now < instant_s:
                self._step_to(min(instant_s, self._next_wake(instant_s)))

    def _next_wake(self, latest_s: float) -> float:
        """Return the first future instant requested by a companion, at most `latest_s`."""
        first = latest_s
        for companion in self._companions:
            instant = companion.wakes_at() if companion.wakes_at is not None else None
            if instant is not None and self._world.now < instant < first:
                first = instant
        return first

    def _step_to(self, instant_s: float) -> None:
        self._world.advance_to(instant_s)
        for companion in self._companions:
            companion.on_advance(instant_s)
