"""Trip of a touch-trigger probe: pretravel, lobing, and noise."""

from __future__ import annotations

import math

import numpy as np

from simulators.scenario import TriggerSettings
from simulators.world.noise import NoiseSource
from twin.collision.geometry import Point
from twin.collision.probe_frame import ProbeFrame

LOBES = 3
"""Number of lobes: a kinematic probe rests on three seats."""


class Trigger:
    """Model of a touch-trigger probe: the tip travel between contact and trip, as a function of the touch direction.
    `frame` gives the direction in which the probe points.
    """

    def __init__(self, settings: TriggerSettings, seed: int, frame: ProbeFrame) -> None:
        self._frame = frame
        self._pretravel_mm = settings.pretravel_um * 1e-3
        self._lobing_mm = settings.lobing_um * 1e-3
        self._sigma_mm = settings.touch_sigma_um * 1e-3
        self._noise = NoiseSource(seed, "trigger")
        self._latch_delay_s = settings.latch_delay_ms * 1e-3
        self.overtravel_mm = settings.overtravel_mm

    def travel_mm(self, direction: Point, touch: int) -> float:
        """Return the tip travel between contact and trip in mm for a touch in `direction`. The noise of the travel
        depends only on the number `touch` of the touch.
        """
        travel = self._pretravel_mm
        if self._lobing_mm:
            # Three-lobed pretravel: amplitude * cos(3 φ), φ the direction about the stylus (Y axis of the probe frame).
            x, _, z = self._frame.to_frame(np.array(direction)).tolist()
            travel += self._lobing_mm * math.hypot(x, z) * math.cos(LOBES * math.atan2(z, x))
        if self._sigma_mm:
            travel += self._sigma_mm * self._noise.normal(touch)[0]
        return travel

    def latch_lag_mm(self, speed_mm_per_s: float, deceleration_mm_per_s2: float) -> float:
        """Return the distance in mm that the axes travel between the trip and the latching of their positions. They
        brake from the trip on.
        """
        # v t - a t² / 2, at most up to the standstill at t = v / a
        late_s = min(self._latch_delay_s, speed_mm_per_s / deceleration_mm_per_s2)
        return speed_mm_per_s * late_s - 0.5 * deceleration_mm_per_s2 * late_s**2
