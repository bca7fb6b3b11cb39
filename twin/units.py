"""Factors between the units of the calculation (mm, rad, s) and those that people read; reference temperature."""

from __future__ import annotations

from collections.abc import Mapping

UM_PER_MM = 1e3
MM_PER_UM = 1e-3
S_PER_MIN = 60.0
S_PER_DAY = 86400.0

MICRO_UNITS: Mapping[str, tuple[str, float]] = {"mm": ("µm", 1e3), "rad": ("µrad", 1e6)}
"""Unit of a parameter to the unit that people read, and the factor."""

REFERENCE_TEMPERATURE_C = 20.0
"""Standard reference temperature of ISO 1."""
