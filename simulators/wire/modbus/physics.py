"""Interfaces of the physics behind the Modbus registers. `simulators.world.controller.Controller` implements them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Protocol

from drivers.roles import AxisLimits, MotionState, Permission, StoreLimits, TableImage, Vector


class ProbeLatch(Protocol):
    @property
    def sequence(self) -> int: ...

    @property
    def position(self) -> Vector: ...


class MovingMachine(Protocol):
    """Interface to the motion, the probe and the permissions of the simulated controller."""

    @property
    def motion(self) -> MotionState: ...

    @property
    def fault(self) -> str: ...

    @property
    def latch(self) -> ProbeLatch | None: ...

    @property
    def probe_deflected(self) -> bool: ...

    @property
    def probe_loaded(self) -> bool: ...

    @property
    def probe_healthy(self) -> bool: ...

    @property
    def permissions(self) -> Mapping[Permission, bool]: ...

    def limits(self) -> AxisLimits: ...

    def trace(self, tag: int) -> None: ...

    def displayed_position(self) -> Vector: ...

    def begin_move(self, target: Vector, feed_mm_per_s: float | None, guarded: bool) -> None: ...

    def begin_touch(self, target: Vector, feed_mm_per_s: float) -> None: ...

    def hold(self) -> None: ...

    def resume(self) -> None: ...

    def halt(self) -> None: ...

    def fail(self, reason: str) -> None: ...

    def reset(self) -> None: ...


class TableMemory(Protocol):
    """Interface to the compensation banks of the simulated controller, including the choice of the active bank."""

    @property
    def banks(self) -> Mapping[int, TableImage]: ...

    @property
    def active_bank(self) -> int: ...

    def write_bank(self, bank: int, image: TableImage) -> None: ...

    def activate(self, bank: int) -> None: ...


class ControllerPhysics(MovingMachine, TableMemory, Protocol):
    """Interface to everything that the Modbus registers need from the simulated controller.

    `simulators.world.controller.Controller` implements it.
    """

    @property
    def store_limits(self) -> StoreLimits: ...

    def temperatures(self) -> Mapping[str, float]: ...
