"""Proxy of the simulated device whose answers and commands a fault can alter."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

from campaigns.plans.motion_run import AlarmClock
from drivers.errors import VolcalError
from drivers.modbus_cnc.device import ModbusCnc
from drivers.reached_position import require_reached
from drivers.roles import Miss, TableImage, Touch, Vector
from simulators.backend import SimulatedMachineDevice
from simulators.world.world import World

DEVICE = "twin"
TOLERANCE_MM = 0.01
"""Largest distance in mm between the target of a move and the position reported after it, as in the drivers."""
LONGEST_NIGHT_S = 6.0 * 3600.0
MOST_ADVANCES = 2_000_000
"""Advances of the clock in one night, several hundred times those of a night without fault."""

Alteration = Callable[..., Any]


class HangDetectedError(BaseException):
    """Raised by the clock of a night that does not end."""


class WatchedClock(AlarmClock):
    """Virtual clock that starts at `start_s` and detects a run without an end, by its machine time or by the number of
    its waits."""

    def __init__(self, start_s: float = 0.0) -> None:
        super().__init__()
        self.watched = False
        self.hung = False
        self._advances = 0
        self._latest_s = start_s + LONGEST_NIGHT_S
        self.advance_to(start_s)
        self.watched = True

    def advance_to(self, instant_s: float) -> None:
        self._advances += 1
        if self.watched and (instant_s > self._latest_s or self._advances > MOST_ADVANCES):
            self.hung = True
            raise HangDetectedError
        super().advance_to(instant_s)


class FaultyDevice:
    """Proxy of the device of a simulated machine. Faults check its calls and alter its methods.

    As every driver does, the proxy of a device without a driver compares the position after a move with its target.
    """

    def __init__(self, device: SimulatedMachineDevice | ModbusCnc, world: World, clock: WatchedClock) -> None:
        self._device = device
        self._world = world
        self._clock = clock
        self._checks: list[Callable[[str], None]] = []
        self._alterations: list[Mapping[str, Alteration]] = []
        self.touches = 0
        self.staged: list[TableImage] = []
        self.moved_until_s = 0.0
        self._position = world.controller.displayed_at(clock.now())  # a resumed run begins where the former one ended

    def __getattr__(self, name: str) -> Any:
        real = getattr(self._device, name)
        return self._altered(name, real) if callable(real) else real

    def open(self) -> None:
        self._device.open()
        self._clock.subscribe(self._note_position)  # after the world, so that the position is that of the instant

    def close(self) -> None:
        self._device.close()

    def move_to(self, target_mm: Vector, *, feed_mm_per_s: float | None, guarded: bool) -> None:
        self._altered("move_to", self._device.move_to)(target_mm, feed_mm_per_s=feed_mm_per_s, guarded=guarded)
        if isinstance(self._device, SimulatedMachineDevice):
            reported = self._altered("position", self._device.position)()
            require_reached(reported.tolist(), target_mm.tolist(), TOLERANCE_MM, "a move", {"device": DEVICE})

    def touch_towards(self, target_mm: Vector, *, feed_mm_per_s: float) -> Touch | Miss:
        touch = self._altered("touch_towards", self._device.touch_towards)
        touched: Touch | Miss = touch(target_mm, feed_mm_per_s=feed_mm_per_s)
        self.touches += 1
        return touched

    def stage(self, bank: int, table: TableImage) -> None:
        self.staged.append(table)
        self._altered("stage", self._device.stage)(bank, table)

    def check(self, check: Callable[[str], None]) -> Callable[[], None]:
        """Call `check(name)`, which may raise an error, before each call of the device. Return a function that ends
        this."""
        self._checks.append(check)
        return partial(_discard, self._checks, check)

    def alter(self, **altered: Alteration) -> Callable[[], None]:
        """Let these functions be called instead of the methods with their names, with the method as first argument: the
        real one, or one that was altered before. Return a function that ends this."""
        self._alterations.append(altered)
        return partial(_discard, self._alterations, altered)

    def _altered(self, name: str, real: Callable[..., Any]) -> Callable[..., Any]:
        def call(*values: Any, **named: Any) -> Any:
            for check in tuple(self._checks):
                check(name)
            function = real
            for altered in self._alterations:
                if name in altered:
                    function = partial(altered[name], function)
            try:
                return function(*values, **named)
            except VolcalError as error:  # a driver names its device in every error
                raise error.at(device=DEVICE) from error.__cause__

        return call

    def _note_position(self, now_s: float) -> None:
        position = self._world.controller.displayed_at(now_s)
        if position != self._position:
            self.moved_until_s, self._position = now_s, position


def _discard(among: list[Any], one: object) -> None:
    """Remove `one` from the list `among` if it is still there."""
    among[:] = [other for other in among if other is not one]
