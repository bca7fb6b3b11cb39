"""Interface of the physics that a simulated GRBL needs. `simulators.world.controller.Controller` implements it."""

from __future__ import annotations

from typing import Protocol

from drivers.roles import AxisLimits, Vector
from simulators.wire.grbl.blocks import Triple, single
from simulators.wire.grbl.settings import STEPS, GrblSettings
from simulators.wire.modbus.physics import MovingMachine


class GrblPhysics(MovingMachine, Protocol):
    """Interface of a moving machine that homes its axes and also predicts the times of its next events."""

    def set_zero(self) -> None: ...

    @property
    def motion_ends_s(self) -> float | None: ...

    @property
    def probe_free_s(self) -> float | None: ...


class MachineCoordinates:
    """Machine coordinates of GRBL. They are 0 at the homing position at the upper end of each axis, and negative
    elsewhere.

    Every position is a whole number of steps, divided by the steps per mm in single precision.
    """

    def __init__(self, limits: AxisLimits, settings: GrblSettings) -> None:
        self._zero = limits.upper_mm
        self._settings = settings

    def from_axes(self, axis_mm: Vector) -> Triple:
        x, y, z = (self._round_to_steps(i, float(value) - self._zero[i]) for i, value in enumerate(axis_mm))
        return x, y, z

    def rounded(self, machine_mm: Triple) -> Triple:
        x, y, z = (self._round_to_steps(i, value) for i, value in enumerate(machine_mm))
        return x, y, z

    def to_axes(self, machine_mm: Triple) -> Triple:
        x, y, z = (self._steps(i, value) + self._zero[i] for i, value in enumerate(machine_mm))
        return x, y, z

    def _round_to_steps(self, axis: int, value_mm: float) -> float:
        return single(self._steps(axis, value_mm))

    def _steps(self, axis: int, value_mm: float) -> float:
        """Return the multiple of the step nearest to `value_mm`, in mm."""
        steps = self._settings[STEPS + axis]
        return round(value_mm * steps) / steps
