"""Rig with the driver on a pseudo-terminal and a simulated GRBL at its other end, in virtual time."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from functools import cache
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np

from drivers.clock import Clock, VirtualClock
from drivers.errors import DeviceError
from drivers.registry import DeviceContext
from drivers.serial_cnc.device import SerialCnc
from drivers.serial_cnc.plugin import PLUGIN
from simulators.scenario import Scenario, read_scenario
from simulators.wire.grbl.dialect import GRBL_11, GrblDialect
from simulators.wire.grbl.port import GrblPort
from simulators.wire.grbl.settings import GrblSettings
from simulators.wire.shared_world import SharedWorld
from simulators.world.world import World

SCENARIO = Path(__file__).resolve().parents[3] / "config" / "simulators" / "case-study.toml"
NUMBERS = count()
TOOL = np.array([0.0, 250.0, 0.0])


@dataclass
class Line:
    """Faulty cable: `on_line` changes each line on its way to the driver."""

    port: GrblPort
    on_line: Callable[[bytes], bytes] | None = None
    said: list[bytes] = field(default_factory=list)

    def distort(self, data: bytes) -> bytes:
        self.said.append(data)
        return data if self.on_line is None else self.on_line(data)

    def once(self, starts: bytes, change: Callable[[bytes], bytes]) -> None:
        """Change the next line that begins with `starts`."""

        def changed(line: bytes) -> bytes:
            if not line.startswith(starts):
                return line
            self.on_line = None
            return change(line)

        self.on_line = changed

    def dead(self) -> None:
        self.on_line = lambda _: b""


@dataclass
class Rig:
    device: SerialCnc
    world: World
    port: GrblPort
    shared: SharedWorld[World]
    clock: VirtualClock
    line: Line

    def at(self, instant_s: float, action: Callable[[], None]) -> None:
        """Run `action` once, when the machine time reaches `instant_s`."""
        done: list[bool] = []

        def check(now_s: float) -> None:
            if now_s >= instant_s and not done:
                done.append(True)
                action()

        self.clock.subscribe(check)

    def type(self, data: bytes) -> None:
        """Feed bytes to the controller as if another user had sent them."""
        with self.shared.lock:
            self.port.controller.received(data)

    def ball(self, number: int) -> np.ndarray:
        return np.array(self.world.workpiece.snapshot(self.world.now).balls[number]) - TOOL

    def before(self, number: int = 5, distance_mm: float = 25.0) -> np.ndarray:
        centre = self.ball(number)
        self.device.move_to(np.array([centre[0], 0.0, centre[2]]), feed_mm_per_s=None, guarded=True)
        self.device.move_to(centre - [0.0, distance_mm, 0.0], feed_mm_per_s=None, guarded=True)
        return centre


@cache
def _scenario() -> Scenario:
    return read_scenario(SCENARIO).without_errors()


@contextmanager
def rig(
    base: Path,
    *,
    settings: dict[int, float] | None = None,
    homed: bool = True,
    dialect: GrblDialect = GRBL_11,
    clock: Clock | None = None,
    **options: Any,
) -> Iterator[Rig]:
    """Create a rig with a device that is not yet open.

    `settings` are `$` values that differ from the defaults; `clock` replaces the virtual clock.
    """
    world = World(_scenario())
    shared = SharedWorld(world)
    told = GrblSettings(world.controller.limits(), dialect=dialect)
    told.change(settings or {})
    # the system's name of a closed terminal may become another test's, which a driver would then open and lock
    link = base / f"tty{next(NUMBERS)}"
    port = GrblPort(shared, str(link), settings=told, homed=homed)
    line = Line(port)
    port.line.distort = line.distort
    port.start()
    virtual = VirtualClock()
    virtual.subscribe(shared.advance_to)
    values = {**port.agent_settings, "response_timeout_s": 0.9, "boot_timeout_s": 1.2, **options}
    device = PLUGIN.create(PLUGIN.settings.model_validate(values), DeviceContext("cnc", clock or virtual, base))
    assert isinstance(device, SerialCnc)
    try:
        yield Rig(device, world, port, shared, virtual, line)
    finally:
        with suppress(DeviceError):  # a dead peer cannot report that its axes are at rest
            device.close()
        port.close()
