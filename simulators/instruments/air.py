"""Refractive index of air, by which the wavelength of a laser interferometer is compensated.

Shop-floor formula of J. A. Stone and J. H. Zimmerman, Engineering Metrology Toolbox (NIST), appendix B; it agrees with
the Ciddor equation within 0.15 ppm for 0 °C to 35 °C and 50 kPa to 120 kPa.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Air:
    """Temperature in °C, pressure in kPa and relative humidity in % of the air along the beam."""

    temperature_c: float
    pressure_kpa: float
    humidity_percent: float

    @property
    def refractivity(self) -> float:
        """Refractive index minus 1 at the wavelength of a helium-neon laser, 633 nm."""
        t = self.temperature_c
        dry = 7.86e-4 * self.pressure_kpa / (273.0 + t)
        return dry - 1.5e-11 * self.humidity_percent * (t * t + 160.0)
