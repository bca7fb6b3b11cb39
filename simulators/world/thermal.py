"""Temperatures by the hour, and how far the tip moves as the machine warms."""

from __future__ import annotations

from simulators.scenario import TemperatureSettings
from simulators.world.field import ZERO
from twin.geometry import Point


class Thermal:
    def __init__(self, settings: TemperatureSettings) -> None:
        self._settings = settings

    def temperatures_c(self, now_s: float) -> dict[str, float]:
        """Named temperatures as the sensors tell them."""
        s, hours = self._settings, now_s / 3600.0
        return {
            "artefact": s.artefact_c + s.artefact_k_per_h * hours,
            "machine": s.machine_c + s.machine_k_per_h * hours,
            "ambient": s.ambient_c,
        }

    def drift_mm(self, now_s: float) -> Point:
        """(3,) of the tip since the start."""
        warmed = self._settings.machine_k_per_h * now_s / 3600.0
        if warmed == 0.0:
            return ZERO
        x, y, z = self._settings.growth_um_per_k
        return x * warmed * 1e-3, y * warmed * 1e-3, z * warmed * 1e-3
