"""Fake controller with straight lines at constant speed, simple enough to be checked by eye."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from drivers.roles import (
    Activation,
    AxisLimits,
    MotionState,
    Permission,
    StoreLimits,
    TableImage,
    Vector,
)

RAPID_MM_PER_S = 200.0


@dataclass
class FakeLatch:
    sequence: int
    position: Vector


@dataclass
class FakeController:
    """Fake controller physics; `wall_y` is a wall that trips the probe when moving towards +Y."""

    now: float = 0.0
    wall_y: float | None = None
    motion: MotionState = MotionState.IDLE
    fault: str = ""
    latch: FakeLatch | None = None
    touch_missed: bool = False
    probe_deflected: bool = False
    probe_loaded: bool = True
    probe_healthy: bool = True
    granted: dict[Permission, bool] = field(default_factory=lambda: dict.fromkeys(Permission, True))
    banks: dict[int, TableImage] = field(default_factory=dict)
    active_bank: int = 0
    activation: Activation = Activation.IMMEDIATE
    position: Vector = field(default_factory=lambda: np.zeros(3))
    temperatures_c: dict[str, float] = field(
        default_factory=lambda: {"machine": -0.125, "ambient": 21.0, "artefact": 20.5}
    )
    orders: list[tuple[str, list[float], float | None]] = field(default_factory=list)
    _target: Vector | None = None
    _speed: float = 0.0
    _kind: str = ""

    @property
    def permissions(self) -> dict[Permission, bool]:
        return self.granted | ({Permission.NO_FAULT: False} if self.motion is MotionState.FAULT else {})

    @property
    def store_limits(self) -> StoreLimits:
        return StoreLimits((1, 2), (20, 10, 10), 1000, 0.0001, 1.0, self.activation)

    def trace(self, tag: int) -> None:
        self.tag = tag

    def limits(self) -> AxisLimits:
        return AxisLimits((0.0, 0.0, -10.0), (4000.0, 1300.0, 1500.0), (200.0,) * 3, (1000.0,) * 3)

    def displayed_position(self) -> Vector:
        return self.position

    def temperatures(self) -> dict[str, float]:
        return self.temperatures_c

    def begin_move(self, target: Vector, feed_mm_per_s: float | None, guarded: bool) -> None:
        self._begin("guarded" if guarded else "move", target, feed_mm_per_s)

    def begin_touch(self, target: Vector, feed_mm_per_s: float) -> None:
        self.touch_missed = False
        self._begin("touch", target, feed_mm_per_s)

    def _begin(self, kind: str, target: Vector, feed_mm_per_s: float | None) -> None:
        self.orders.append((kind, [float(x) for x in target], feed_mm_per_s))
        self._kind, self._target, self._speed = kind, target, feed_mm_per_s or RAPID_MM_PER_S
        self.motion = MotionState.MOVING

    def hold(self) -> None:
        self.motion = MotionState.HELD

    def resume(self) -> None:
        self.motion = MotionState.MOVING

    def halt(self) -> None:
        self.motion = MotionState.IDLE

    def fail(self, reason: str) -> None:
        self.motion, self.fault = MotionState.FAULT, reason

    def reset(self) -> None:
        self.motion, self.fault = MotionState.IDLE, ""

    def write_bank(self, bank: int, image: TableImage) -> None:
        self.banks[bank] = image

    def activate(self, bank: int) -> None:
        self.active_bank = bank

    def advance_to(self, instant_s: float) -> None:
        if self.motion is MotionState.MOVING and self._target is not None:
            self._move(self._target, self._speed * (instant_s - self.now))
        self.now = instant_s

    def _move(self, target: Vector, distance: float) -> None:
        way = target - self.position
        left = float(np.linalg.norm(way))
        end = target if distance >= left - 1e-9 else self.position + way * (distance / left)
        if self.wall_y is not None and self._kind != "move" and end[1] >= self.wall_y:
            self.position = np.array([end[0], self.wall_y, end[2]])
            self._tripped()
            return
        self.position = np.array(end)
        if distance >= left - 1e-9:
            self.motion = MotionState.IDLE
            self.touch_missed = self._kind == "touch"

    def _tripped(self) -> None:
        if self._kind == "touch":
            number = self.latch.sequence + 1 if self.latch is not None else 1
            self.latch = FakeLatch(number, self.position)
            self.motion = MotionState.IDLE
        else:
            self.motion, self.fault = MotionState.FAULT, "probe tripped"


@dataclass
class FakeWorld:
    controller: FakeController = field(default_factory=FakeController)

    @property
    def now(self) -> float:
        return self.controller.now

    def advance_to(self, instant_s: float) -> None:
        self.controller.advance_to(instant_s)
