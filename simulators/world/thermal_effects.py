"""Thermometer readings, and the effects of the machine temperature on the tip position and on the deviation field."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np

from simulators.temperatures import ThermalSettings
from simulators.world.field import ZERO, FieldOfMany
from simulators.world.noise import generator
from simulators.world.thermal_state import S_PER_H, ThermalState
from twin.arrays import Array
from twin.collision.geometry import Point
from twin.machine.error_model import Ranges

ARTEFACT, MACHINE, AMBIENT = "artefact", "machine", "ambient"


class ThermalEffects:
    """Thermal model of one machine: thermometer readings, tip drift and deformation.

    The travel ranges `ranges_mm` of the axes and `tool_offset_mm` determine the lever arms of the thermal deformation.
    `seed` is the seed of the thermometer noise.
    """

    def __init__(
        self,
        settings: ThermalSettings,
        ranges_mm: Ranges = ((0.0, 1.0), (0.0, 1.0), (0.0, 1.0)),
        tool_offset_mm: Point = ZERO,
        seed: int = 0,
    ) -> None:
        self._settings = settings
        self._ranges_mm = ranges_mm
        self._tool_offset_mm = tool_offset_mm
        self._seed = seed
        self.state = ThermalState(settings)

    # ------------------------------------------------------------------ thermometers

    def temperatures_c(self, now_s: float) -> dict[str, float]:
        """Return the thermometer reading in °C of each sensor by its name, including lag, offset and noise of the
        sensor.
        """
        s, state = self._settings, self.state
        bodies = {ARTEFACT: state.artefact_c, MACHINE: state.machine_c, AMBIENT: state.ambient_c}
        for number in range(2, s.artefact_sensors + 1):
            bodies[f"{ARTEFACT}-{number}"] = state.artefact_c
        for name in s.body_time_constants_h:
            bodies[name] = partial(state.body_c, name)
        return {name: self._reading_c(name, true_c, now_s) for name, true_c in bodies.items()}

    def _reading_c(self, name: str, true_c: Callable[[float], float], now_s: float) -> float:
        """Return the reading of one thermometer at a body whose true temperature is `true_c(seconds)`."""
        shown_s = min(now_s, S_PER_H * self._settings.sensor_stuck_after_h.get(name, math.inf))
        # a sensor shows the temperature of `sensor_lag_s` ago
        return true_c(max(shown_s - self._settings.sensor_lag_s, 0.0)) + self._error_k(name, shown_s)

    def _error_k(self, name: str, now_s: float) -> float:
        s = self._settings
        offset = s.sensor_offset_k.get(name, 0.0)
        if s.sensor_noise_k == 0.0:
            return offset
        # The instant names the random number: asking twice at one instant gives one reading, and the order of requests
        # does not matter.
        reading = generator(self._seed, f"thermometer {name} {round(1e3 * now_s)}")
        return offset + s.sensor_noise_k * float(reading.standard_normal())

    # ------------------------------------------------------------------ deformation

    def drift_mm(self, now_s: float) -> Point:
        """Return the displacement of the tip by thermal growth of spindle and ram since the start of the simulation,
        shape (3,), in mm.
        """
        if self.state.machine_is_constant:
            return ZERO
        warmed = self.state.machine_change_k(now_s)
        x, y, z = self._settings.growth_um_per_k
        return x * warmed * 1e-3, y * warmed * 1e-3, z * warmed * 1e-3

    def field(self, now_s: float) -> FieldOfMany | None:
        """Return the thermal change of the machine's deviation field (tip deviation as a function of axis position)
        since the start of the simulation, or None if the machine's temperature is constant.
        """
        if self.state.machine_is_constant:
            return None
        s = self._settings
        warmed = self.state.machine_change_k(now_s)
        stretch = 1e-6 * warmed * np.array(s.scale_um_per_m_k)
        bend_mm = 1e-3 * s.bend_um_per_k * self.state.column_change_k(now_s)
        if bend_mm == 0.0 and not stretch.any():
            return None
        return ThermalField(stretch, bend_mm, self._ranges_mm, self._tool_offset_mm)


@dataclass(frozen=True, eq=False)
class ThermalField:
    """Thermal deformation of a machine with changed scales and a bent column, as a function of the axis position.

    `stretch`, shape (3,), is the relative change of the scale of each axis; the zero of each scale stays in place. The
    column is a cantilever that is heated from one side, and it bends along Y. At the position z of the Z axis, the
    displacement of the column is `bend_mm` ((z - z0)/Lz)². In this formula z0 is the lower end of the Z travel, and Lz
    is the length of the Z travel. The slope of the column is a rotation about X of everything that the column carries.
    The tip of a tool that extends along Y is therefore lowered, and that of a tool that extends along Z is moved along
    Y.
    """

    stretch: Array
    bend_mm: float
    ranges_mm: Ranges
    tool_offset_mm: Point

    def __call__(self, axis_positions: Array) -> Array:
        """Return the deviations (n, 3) at the uncorrected axis positions (n, 3), both in mm."""
        change = axis_positions * self.stretch
        low, high = self.ranges_mm[2]
        height = (axis_positions[:, 2] - low) / (high - low)
        change[:, 1] += self.bend_mm * height**2
        # Rotation about X by the slope dw/dz = 2 bend (z - z0)/Lz²; the lever arms are the tip's Y and the tool's Z.
        slope = 2.0 * self.bend_mm * height / (high - low)
        change[:, 1] += slope * self.tool_offset_mm[2]
        change[:, 2] -= slope * (axis_positions[:, 1] + self.tool_offset_mm[1])
        return np.asarray(change)


def artefact_bow_mm(settings: ThermalSettings, warming: ThermalState, now_s: float) -> float:
    """Return the thermal bow of the artefact at instant `now_s` in mm.

    The bow is the displacement of the artefact's middle from the straight line between its ends.
    """
    if settings.artefact_bow_um_per_k == 0.0:
        return 0.0
    return 1e-3 * settings.artefact_bow_um_per_k * warming.artefact_lag_k(now_s)


def bend_balls(balls: Array, bow: float) -> Array:
    """Return the N ball centres, shape (N, 3) in mm, of an artefact along X after the artefact is bent to an arc.

    The ends of the artefact stay in place, and its middle is displaced by `bow` mm along Z.
    """
    along = balls[:, 0]
    half = 0.5 * float(np.ptp(along))
    if bow == 0.0 or not math.isfinite(half) or half == 0.0:
        return balls
    out = balls.copy()
    # Parabola through the fixed ends: w(x) = bow (1 - ((x - mean)/half)²).
    out[:, 2] += bow * (1.0 - ((along - along.mean()) / half) ** 2)
    return out
