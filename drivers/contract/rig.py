"""What the contract is told about the machine that it is run on."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from drivers.clock import Clock
from drivers.roles import CompensationStore, Machine, MotionState, Probe, RotaryMount, TableImage, Thermometer, Vector


class StoppedError(Exception):
    """What breaks a wait off in these tests."""


@dataclass
class Interrupt:
    """Raises from the clock's sleeps once its time has come to `at_s`: give the driver
    ``InterruptibleClock(clock, interrupt.check)``."""

    clock: Clock
    at_s: float | None = None

    def check(self) -> None:
        if self.at_s is not None and self.clock.now() >= self.at_s:
            self.at_s = None
            raise StoppedError

    def after(self, duration_s: float) -> None:
        self.at_s = self.clock.now() + duration_s


class ContractRig(ABC):
    """A machine with one obstacle, in front of which the tip can be brought.

    Only the roles that are tested need be there. `clock` is the one that the driver has; `interrupt` is watched by it.
    Positions are axis positions, mm.
    """

    clock: Clock
    interrupt: Interrupt
    machine: Machine
    probe: Probe
    mount: RotaryMount
    store: CompensationStore
    thermometer: Thermometer

    start_mm: ClassVar[tuple[float, float, float]] = (0.0, 0.0, 0.0)
    """A place from which +X is free for 1000 mm."""

    free_mm: ClassVar[tuple[float, float, float]] = (123.456, 0.0, 78.9)
    """Another that is free, and the way to it from the start too."""

    outside_mm: ClassVar[tuple[tuple[float, float, float], ...]] = ((1e9, 0.0, 0.0), (0.0, 0.0, -1e9))
    """Targets outside the travel."""

    clear_of_mount_mm: ClassVar[tuple[float, float, float]] = (0.0, 0.0, 0.0)
    """Where the tip is out of the way of everything that turns."""

    resolution_mm: float = 1e-5
    """To which positions travel on the link."""

    @abstractmethod
    def approach(self) -> Vector:
        """Bring the tip before the obstacle, 25 mm of free way along +Y ahead of it at least 5; returns a target inside
        the obstacle, straight ahead along +Y."""

    @abstractmethod
    def trip_mm(self, target_mm: Vector) -> Vector:
        """Where the probe trips on the way from `approach` to the target it returned."""

    def table(self, factor: int = 1) -> TableImage:
        """A table that the store takes; another one for each `factor`."""
        limits = self.store.store_limits()
        counts = np.arange(3 * 2 * 4 * 3, dtype=np.int32).reshape(3, 2, 4, 3) * factor - 30
        return TableImage((0.0, 0.0, 0.0), (2000.0, 1300.0, 500.0), limits.resolution_mm, counts)

    def go(self, target_mm: tuple[float, float, float] | Vector) -> None:
        self.machine.move_to(np.array(target_mm, dtype=float), feed_mm_per_s=None, guarded=False)

    def await_rest(self) -> None:
        for _ in range(100):
            if self.machine.status().state is not MotionState.MOVING:
                return
            self.clock.sleep(0.1)
        raise AssertionError("the machine does not come to rest")
