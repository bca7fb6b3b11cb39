"""Legendre polynomials on an axis range normalised to [-1, 1]."""

from __future__ import annotations

import numpy as np

from twin.arrays import Array


def normalised(positions: Array, axis_range: tuple[float, float]) -> Array:
    """Axis positions (n,) in mm brought to [-1, 1] over `axis_range`; outside the range the line goes on."""
    low, high = axis_range
    return (positions - 0.5 * (low + high)) * (2.0 / (high - low))


def legendre_values(argument: Array, order: int) -> Array:
    """P_0 ... P_order at `argument` (n,) as rows: (order + 1, n). Bonnet's recurrence (DLMF 18.9.1)."""
    values = np.empty((order + 1, argument.size))
    values[0] = 1.0
    if order > 0:
        values[1] = argument
    for k in range(1, order):
        row = values[k + 1]
        np.multiply(argument, values[k], out=row)
        row *= (2.0 * k + 1.0) / (k + 1.0)
        row -= (k / (k + 1.0)) * values[k - 1]
    return values
