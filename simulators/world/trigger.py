"""How a touch-trigger probe trips: pretravel by direction, lobing, noise."""

from __future__ import annotations

import math

from simulators.scenario import TriggerSettings
from simulators.world.noise import NoiseSource
from twin.collision.geometry import Point

LOBES = 3
"""A kinematic probe stands on three seats."""


class Trigger:
    """Travel from contact to trip in mm, for a touch in a given direction; the probe points along +Y."""

    def __init__(self, settings: TriggerSettings, seed: int) -> None:
        self._pretravel_mm = settings.pretravel_um * 1e-3
        self._lobing_mm = settings.lobing_um * 1e-3
        self._sigma_mm = settings.touch_sigma_um * 1e-3
        self._noise = NoiseSource(seed, "trigger")
        self.overtravel_mm = settings.overtravel_mm

    def travel_mm(self, direction: Point, touch: int) -> float:
        """`touch` counts the touches: the same touch has the same noise whenever it is asked for."""
        travel = self._pretravel_mm
        if self._lobing_mm:
            x, _, z = direction
            travel += self._lobing_mm * math.hypot(x, z) * math.cos(LOBES * math.atan2(z, x))
        if self._sigma_mm:
            travel += self._sigma_mm * self._noise.normal(touch)[0]
        return travel
