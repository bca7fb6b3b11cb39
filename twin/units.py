"""Conversion factors from the units of calculation (mm, rad, s) to those of reports, and the reference temperature of
ISO 1.
"""

from __future__ import annotations

from collections.abc import Mapping

UM_PER_MM = 1e3
MM_PER_UM = 1e-3
S_PER_MIN = 60.0
S_PER_DAY = 86400.0

MICRO_UNITS: Mapping[str, tuple[str, float]] = {"mm": ("µm", 1e3), "rad": ("µrad", 1e6)}
"""Map from the unit of a parameter to the unit in which it is reported and the conversion factor."""

REFERENCE_TEMPERATURE_C = 20.0
"""Standard reference temperature of ISO 1."""
