"""Test rig of the contract tests: the device under test and the axis positions that the tests may use on it."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from drivers.clock import Clock
from drivers.roles import CompensationStore, Machine, MotionState, Probe, RotaryMount, TableImage, Thermometer, Vector


class StoppedError(Exception):
    """Exception by which the contract tests interrupt a wait of a driver."""


def _stop() -> None:
    raise StoppedError


@dataclass
class Interrupt:
    """Planned interruption of a wait of a driver: as soon as `clock` reaches `at_s`, `check` calls `action` once, which
    raises `StoppedError` by default.

    Give the driver the clock ``InterruptibleClock(clock, interrupt.check)``; it calls `check` while it sleeps.
    """

    clock: Clock
    at_s: float | None = None
    action: Callable[[], None] = _stop

    def check(self) -> None:
        if self.at_s is not None and self.clock.now() >= self.at_s:
            self.at_s = None
            self.action()

    def after(self, duration_s: float, action: Callable[[], None] = _stop) -> None:
        self.at_s, self.action = self.clock.now() + duration_s, action


class ContractRig(ABC):
    """Machine for contract tests of drivers, with one obstacle that the stylus tip can approach.

    A subclass needs to provide only the devices whose roles are tested. `clock` is the clock of the driver; it must
    call `interrupt.check`, by which the tests interrupt waits, while it sleeps. Positions are axis positions in mm.
    """

    clock: Clock
    interrupt: Interrupt
    machine: Machine
    probe: Probe
    mount: RotaryMount
    store: CompensationStore
    thermometer: Thermometer

    start_mm: ClassVar[tuple[float, float, float]] = (0.0, 0.0, 0.0)
    """Position from which the path along +X is free of obstacles, and within the travel, for 300 mm."""

    free_mm: ClassVar[tuple[float, float, float]] = (123.456, 0.0, 78.9)
    """Another free position; the straight path from `start_mm` to it is free as well."""

    outside_mm: ClassVar[tuple[tuple[float, float, float], ...]] = ((1e9, 0.0, 0.0), (0.0, 0.0, -1e9))
    """Positions outside the travel."""

    clear_of_mount_mm: ClassVar[tuple[float, float, float]] = (0.0, 0.0, 0.0)
    """Position at which the tip is clear of the mount and of everything that turns with it."""

    resolution_mm: float = 1e-5
    """Resolution of positions on the link, mm."""

    @abstractmethod
    def approach(self) -> Vector:
        """Move the stylus tip in front of the obstacle, and return a target inside the obstacle.

        The target may lie in any direction from the tip. The path to the obstacle must be free over at least 5 mm; 25
        mm is usual.
        """

    def towards(self, target_mm: Vector) -> Vector:
        """Return the unit vector (3,) from the present position of the machine to `target_mm`."""
        path = np.asarray(target_mm) - self.machine.position()
        return np.asarray(path / np.linalg.norm(path))

    @abstractmethod
    def trip_mm(self, target_mm: Vector) -> Vector:
        """Return the axis position, shape (3,), in mm at which the probe trips on the path to `target_mm`.

        `target_mm` is the target that `approach` has returned. The path starts at the position to which `approach` has
        moved the tip.
        """

    def table(self, factor: int = 1) -> TableImage:
        """Return a compensation table that the store under test accepts; each `factor` gives a different table."""
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
