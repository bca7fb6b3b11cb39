"""Limits of the gates between an estimate and a machine."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class GateLimits:
    """Bounds of the settings' `[gates]` section; µm where the name says so."""

    max_chi2: float
    min_degrees_of_freedom: int
    max_remaining_fraction: float
    max_correction_um: float
    max_slope_um_per_mm: float
    allow_extrapolation: bool
    max_change: float = 3.0
