"""Limits of the gates between an estimate and a machine."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class GateLimits:
    """Bounds of the settings' `[gates]` section; µm where the name says so."""

    largest_chi2: float
    smallest_freedom: int
    largest_remaining_share: float
    largest_correction_um: float
    largest_slope_um_per_mm: float
    allow_extrapolation: bool
    largest_change: float = 3.0
