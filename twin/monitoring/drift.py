"""Drift per night by weighted linear regression, and the night in which a drifting value will reach its limit.

Steps at known times have separate terms, which prevent them from biasing the drift. The value y_i of night t_i is
modelled as y_i = level + slope (t_i - t_n) - (sum of the sizes of all steps later than t_i), where t_n is the last
night.

The variances of the values are assumed to be proportional to the stated variances. The factor of proportionality is
estimated from the residuals (GUM Type A; Deming 1943), because contributions common to all nights (the calibration
certificate of the artefact, the prior of the identification) are part of the stated uncertainty but cause no scatter
about a trend. With fewer than `MIN_FREEDOM_FOR_SCALE` degrees of freedom, the stated uncertainties are used unchanged.
If the estimates of neighbouring nights share information, they scatter too little. Therefore, if the residuals have a
lag-1 correlation r > 0, the variance is multiplied by (1 + r) / (1 - r) (Bartlett 1935).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import stdtrit

from twin.arrays import Array
from twin.errors import DataError
from twin.monitoring.level_regression import LevelRegression

_BISECTIONS = 60  # of the horizon: 2⁻⁶⁰ of it is below the rounding of a double
SAME_NIGHT = 1e-9  # nights; two runs are further apart
MIN_FREEDOM_FOR_SCALE = 4
COVERAGE = 0.95
# Few nights give a poor correlation; at 0.9 the variance is multiplied by 19, at 1 by infinity.
_HIGHEST_CORRELATION = 0.9


@dataclass(frozen=True, eq=False)
class Drift:
    """Straight line fitted to the values of n nights, in the unit of the values.

    `level` is the value of the fitted line at the last night, and `slope` is its change per night. `level_sigma` and
    `slope_sigma` are the standard uncertainties of `level` and `slope`, and `covariance` is their covariance. `steps`
    contains one tuple for each step (sudden change of level): the first night after the step, the size of the step, and
    its standard uncertainty. `fitted`, shape (n,), contains the fitted values.

    `scatter` is the factor by which the stated uncertainties of the values were multiplied, `correlation` is the lag-1
    correlation of the residuals, and `freedom` is the number of degrees of freedom. `factor` is the coverage factor for
    95 %; it is 1.96 if the stated uncertainties were used unchanged.
    """

    level: float
    level_sigma: float
    slope: float
    slope_sigma: float
    covariance: float
    steps: tuple[tuple[float, float, float], ...]
    fitted: Array
    scatter: float
    correlation: float
    freedom: int
    factor: float

    @property
    def significant(self) -> bool:
        """True if the magnitude of the fitted slope exceeds its expanded uncertainty (95 %)."""
        return abs(self.slope) > self.factor * self.slope_sigma

    def predict(self, nights: float) -> tuple[float, float]:
        """Predict the value of the fitted line `nights` nights after the last measured night.

        Return the predicted value and its standard uncertainty.
        """
        return self.level + self.slope * nights, float(self.line_sigma(np.array([nights]))[0])

    def line_sigma(self, nights: Array) -> Array:
        """Return the standard uncertainty of the fitted line `nights` nights after the last measured night, shape
        (n,)."""
        # Var(level + n slope), with the covariance that the fit gives to level and slope
        variance = self.level_sigma**2 + 2.0 * nights * self.covariance + (nights * self.slope_sigma) ** 2
        sigma: Array = np.sqrt(np.maximum(variance, 0.0))
        return sigma


def fit_drift(nights: ArrayLike, values: ArrayLike, sigmas: ArrayLike, steps: Sequence[float] = ()) -> Drift:
    """Fit a straight line, the drift, to the `values` that were measured in n `nights`.

    The nights must be in ascending order. `sigmas` contains the standard uncertainties of the values. These three
    arrays have shape (n,). `steps` contains the times, in nights, at which a new level begins. Raises DataError if
    there are too few values or if the input is invalid.
    """
    t, y, u = (np.asarray(given, dtype=np.float64) for given in (nights, values, sigmas))
    _check(t, y, u)
    freedom = len(y) - 2 - len(steps)
    if freedom < 0 or not is_determined(t, steps):
        raise DataError(f"{len(y)} values are too few for a drift with {len(steps)} steps")
    found = LevelRegression.of(t, y, u, steps)
    scatter, correlation = _scatter(found.residuals, freedom)
    factor_of_variance = scatter**2 * (1.0 + correlation) / (1.0 - correlation)
    # The slope is independent of the means of the levels, from which it extrapolates to the last night.
    slope_variance = factor_of_variance / found.spread
    mean_variances = factor_of_variance / found.totals
    level_variance = mean_variances[-1] + found.means[-1] ** 2 * slope_variance
    step_variances = mean_variances[1:] + mean_variances[:-1] + np.diff(found.means) ** 2 * slope_variance
    # With the stated uncertainties, nothing was estimated from the scatter: Student's t with 10⁶ degrees of freedom is
    # the normal distribution, factor 1.96.
    factor = float(stdtrit(freedom if freedom >= MIN_FREEDOM_FOR_SCALE else 1e6, 0.5 + 0.5 * COVERAGE))
    return Drift(
        level=float(found.intercepts[-1]),
        level_sigma=math.sqrt(level_variance),
        slope=found.slope,
        slope_sigma=math.sqrt(slope_variance),
        covariance=-float(found.means[-1]) * slope_variance,
        steps=tuple(
            (float(at), float(size), float(u_size))
            for at, size, u_size in zip(sorted(steps), np.diff(found.intercepts), np.sqrt(step_variances), strict=True)
        ),
        fitted=found.fitted,
        scatter=scatter,
        correlation=correlation,
        freedom=freedom,
        factor=factor,
    )


def is_determined(t: Array, steps: Sequence[float]) -> bool:
    """Return True if the drift regression for the nights `t` and the `steps` has a single solution: there are values on
    each level, and on one of them values of different nights, which determine the slope.
    """
    levels = np.searchsorted(np.sort(steps), t, side="right")
    same_level = np.diff(levels) == 0
    return len(np.unique(levels)) == len(steps) + 1 and bool((np.diff(t)[same_level] > SAME_NIGHT).any())


def _scatter(residuals: Array, freedom: int) -> tuple[float, float]:
    """Return the factor by which the stated uncertainties are multiplied, and the lag-1 correlation of the residuals.

    A negative correlation is replaced by 0.
    """
    square = float(residuals @ residuals)
    if freedom < MIN_FREEDOM_FOR_SCALE or square == 0.0:
        return 1.0, 0.0
    correlation = float(residuals[1:] @ residuals[:-1]) / square
    return float(np.sqrt(square / freedom)), float(np.clip(correlation, 0.0, _HIGHEST_CORRELATION))


def _check(t: Array, y: Array, u: Array) -> None:
    if not len(t) == len(y) == len(u) or len(t) < 2:
        raise DataError("a drift needs times, values and uncertainties of at least two nights")
    if not (np.isfinite(t).all() and np.isfinite(y).all() and (u > 0.0).all()):
        raise DataError("times and values must be finite, uncertainties above zero")
    if (np.diff(t) < 0.0).any():
        raise DataError("the nights are not in order")


@dataclass(frozen=True)
class LimitCrossing:
    """Number of nights from the last measured night until a drifting value reaches `limit`.

    `expected` is the number of nights until the straight line fitted to the measured values reaches the limit.
    `earliest` is the number of nights until the edge of the 95 % uncertainty band of this line reaches the limit. Each
    number is 0 if the limit is already reached, and infinite if the limit is not reached within the horizon of the
    computation.
    """

    limit: float
    expected: float
    earliest: float

    @property
    def reached(self) -> bool:
        return self.expected <= 0.0


def limit_crossing(drift: Drift, limit: float, horizon: float, *, two_sided: bool) -> LimitCrossing:
    """Return the number of nights until the fitted `drift` reaches `limit`, as expected and at the earliest.

    `limit` has the unit of the values to which `drift` was fitted. Only the next `horizon` nights are considered. If
    `two_sided`, the limits are `limit` and -`limit`; otherwise `limit` is the only limit, an upper one.
    """
    sides = (1.0, -1.0) if two_sided else (1.0,)
    expected = min(_line(drift, limit, side, horizon) for side in sides)
    earliest = min(_band(drift, limit, side, horizon) for side in sides)
    return LimitCrossing(limit, expected, min(earliest, expected))


def _line(drift: Drift, limit: float, side: float, horizon: float) -> float:
    room = limit - side * drift.level
    if room <= 0.0:
        return 0.0
    rate = side * drift.slope
    return room / rate if rate > 0.0 and room <= rate * horizon else math.inf


def _band(drift: Drift, limit: float, side: float, horizon: float) -> float:
    """Return the first night at which the upper edge of the band, value + coverage factor · uncertainty, reaches the
    limit.

    `side` is -1 for the lower limit, for which the sign of the value is reversed. The edge of the band is convex, so it
    crosses the limit only once if it begins below the limit. This night is found by bisection. The result is 0 if the
    edge is already beyond the limit, and infinite if it does not reach the limit within the horizon.
    """

    def beyond(nights: float) -> bool:
        value, sigma = drift.predict(nights)
        return side * value + drift.factor * sigma >= limit

    if beyond(0.0):
        return 0.0
    if not beyond(horizon):
        return math.inf
    low, high = 0.0, horizon
    for _ in range(_BISECTIONS):
        middle = 0.5 * (low + high)
        low, high = (low, middle) if beyond(middle) else (middle, high)
    return high
