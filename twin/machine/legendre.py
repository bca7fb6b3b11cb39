"""Legendre polynomials on an axis range normalised to [-1, 1]."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.polynomial.legendre import leg2poly

from twin.arrays import Array


def normalise_positions(positions: Array, axis_range: tuple[float, float]) -> Array:
    """Map axis positions (n,) in mm linearly from `axis_range` to [-1, 1].

    Positions outside the range are mapped to values outside [-1, 1].
    """
    low, high = axis_range
    return (positions - 0.5 * (low + high)) * (2.0 / (high - low))


def legendre_values(argument: Array, order: int) -> Array:
    """Return the Legendre polynomials P_0 … P_order at `argument` as an array (order + 1, *shape of `argument`).

    The values are computed by Bonnet's recurrence (DLMF 18.9.1).
    """
    values = np.empty((order + 1, *argument.shape))
    values[0] = 1.0
    if order > 0:
        values[1] = argument
    for k in range(1, order):
        # (k + 1) P_{k+1} = (2k + 1) x P_k - k P_{k-1}
        row = values[k + 1]
        np.multiply(argument, values[k], out=row)
        row *= (2.0 * k + 1.0) / (k + 1.0)
        row -= (k / (k + 1.0)) * values[k - 1]
    return values


def to_power_series(coefficients: Array) -> Array:
    """Convert m Legendre series (m, order + 1) to series in powers of the argument.

    The evaluation of a power series takes one multiplication per power. On [-1, 1] the loss of precision is
    proportional to the largest power coefficient (8 at order 5, 1e5 at order 15). For errors of tens of micrometres the
    loss is below 1e-12 mm.
    """
    series: Array = coefficients @ _to_powers(coefficients.shape[-1])
    return series


@lru_cache(maxsize=16)
def _to_powers(size: int) -> Array:
    # row k holds the power coefficients of P_k
    rows = [np.pad(leg2poly(row[: k + 1]), (0, size - 1 - k)) for k, row in enumerate(np.eye(size))]
    return np.array(rows)
