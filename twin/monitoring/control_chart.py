"""Control charts of single values: individuals chart and EWMA chart (exponentially weighted moving average).

The individuals chart (Shewhart, with limits from the moving range) follows ISO 7870-2. The EWMA chart follows ISO
7870-6. Its weight of 0.2 and its limit width of 2.962 standard deviations are those of Lucas & Saccucci, Technometrics
32 (1990); they give one false alarm in 500 points on average.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from twin.arrays import Array
from twin.errors import DataError

D2 = 2.0 / math.sqrt(math.pi)
"""Expected range of two standard normal values, 1.128."""
LIMIT_WIDTH = 3.0
EWMA_WEIGHT = 0.2
EWMA_LIMIT_WIDTH = 2.962
MIN_VALUES = 3


@dataclass(frozen=True, eq=False)
class IndividualsChart:
    """Individuals chart (control chart of single values) with centre line and limits in the unit of the values.

    `sigma` is the standard deviation of a single value. `outside` contains the indices of the values beyond a limit.
    """

    centre: float
    sigma: float
    lower: float
    upper: float
    outside: tuple[int, ...]


@dataclass(frozen=True, eq=False)
class EwmaChart:
    """Control chart of n values by their exponentially weighted moving average (EWMA).

    `values` contains the moving averages, `lower` and `upper` contain their limits; each has shape (n,). `outside`
    contains the indices of the moving averages that are beyond a limit.
    """

    values: Array
    lower: Array
    upper: Array
    outside: tuple[int, ...]


def individuals_chart(values: ArrayLike) -> IndividualsChart:
    """Return the individuals chart of `values`, shape (n,), in order of time.

    Raises DataError if n is less than 3 or if a value is not finite.
    """
    found = _series(values)
    # From successive differences, not from the deviations from the mean: a slow trend would widen the limits that are
    # to reveal it.
    sigma = float(np.abs(np.diff(found)).mean()) / D2
    centre = float(found.mean())
    lower, upper = centre - LIMIT_WIDTH * sigma, centre + LIMIT_WIDTH * sigma
    outside = np.flatnonzero((found < lower) | (found > upper))
    return IndividualsChart(centre, sigma, lower, upper, tuple(outside.tolist()))


def ewma_chart(values: ArrayLike, centre: float, sigma: float) -> EwmaChart:
    """Return the control chart of the exponentially weighted moving averages (EWMA) z_i of `values` x_1 … x_n.

    The averages are z_i = w x_i + (1 - w) z_(i-1). The weight w is `EWMA_WEIGHT`, and z_0 is `centre`. `sigma` is the
    standard deviation of a single value. The limits use the exact variance of z_i, which depends on i. Raises DataError
    if n is less than 3 or if a value is not finite.
    """
    found = _series(values)
    smooth = np.empty_like(found)
    last = centre
    for index, value in enumerate(found):
        last = EWMA_WEIGHT * float(value) + (1.0 - EWMA_WEIGHT) * last
        smooth[index] = last
    # Var z_i = σ² w / (2 - w) (1 - (1 - w)^2i)
    powers = (1.0 - EWMA_WEIGHT) ** (2.0 * np.arange(1, len(found) + 1))
    half = EWMA_LIMIT_WIDTH * sigma * np.sqrt(EWMA_WEIGHT / (2.0 - EWMA_WEIGHT) * (1.0 - powers))
    outside = np.flatnonzero(np.abs(smooth - centre) > half)
    return EwmaChart(smooth, centre - half, centre + half, tuple(outside.tolist()))


def _series(values: ArrayLike) -> Array:
    found = np.asarray(values, dtype=np.float64)
    if found.ndim != 1 or len(found) < MIN_VALUES or not np.isfinite(found).all():
        raise DataError(f"a control chart needs at least {MIN_VALUES} finite values in a row")
    return found
