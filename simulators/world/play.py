"""What a motion leaves behind on an axis: half the backlash against its direction, and a scatter."""

from __future__ import annotations

import math

from simulators.scenario import AxisBehaviour
from simulators.world.field import ZERO
from simulators.world.noise import NoiseSource
from twin.geometry import Point


class Play:
    """An axis that did not move keeps what it had."""

    def __init__(self, behaviour: AxisBehaviour, seed: int) -> None:
        self._half_backlash_mm = 0.5e-3 * behaviour.backlash_um
        self._sigma_mm = 1e-3 * behaviour.repeatability_um
        self._noise = NoiseSource(seed, "axes")
        self._motions = 0
        self._play = ZERO

    def after(self, direction: Point) -> Point:
        """(3,) mm during and after a motion along the unit vector `direction`."""
        self._motions += 1
        if not (self._half_backlash_mm or self._sigma_mm):
            return ZERO
        scatter = self._noise.normal(self._motions) if self._sigma_mm else ZERO
        x, y, z = (
            before if part == 0.0 else self._sigma_mm * noise - math.copysign(self._half_backlash_mm, part)
            for before, part, noise in zip(self._play, direction, scatter, strict=True)
        )
        self._play = (x, y, z)
        return self._play
