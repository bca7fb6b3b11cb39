"""Changes of the machine's deviation field during a simulation: by its temperature, and by a collision."""

from __future__ import annotations

from dataclasses import dataclass

from simulators.world.field import FieldOfMany
from simulators.world.thermal_effects import ThermalEffects
from twin.arrays import Array
from twin.machine.true_machine import TrueMachine


@dataclass(frozen=True, eq=False)
class CollisionInRun:
    """Collision at the instant `at_s`, which turns the machine `before` into the machine `after`.

    Called with axis positions (n, 3) in mm, it returns the change of the deviation (n, 3) in mm.
    """

    at_s: float
    before: TrueMachine
    after: TrueMachine

    def __call__(self, axis_positions: Array) -> Array:
        return self.after.deviation(axis_positions) - self.before.deviation(axis_positions)


@dataclass(frozen=True, eq=False)
class FieldChanges:
    """Changes of the deviation field since the start of the simulation."""

    thermal: ThermalEffects
    collision: CollisionInRun | None = None

    def field(self, now_s: float) -> FieldOfMany | None:
        """Return the change of the deviation field (tip deviation as a function of axis position) until the instant
        `now_s`, or None if nothing has changed."""
        warm, struck = self.thermal.field(now_s), self.collision
        if struck is None or now_s < struck.at_s:
            return warm
        if warm is None:
            return struck
        return lambda axis_positions: warm(axis_positions) + struck(axis_positions)
