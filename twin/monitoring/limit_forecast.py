"""Probability that a drifting value reaches its limit within a number of nights.

The true value is modelled as a Brownian motion of variance q per night with a slope that is itself a Brownian motion,
of variance s per night, and each measured value as the true value plus an error of variance r u_i², where u_i is the
stated standard uncertainty. At a step, the level begins anew.

Level and slope at the last night follow from a Kalman filter with a diffuse start (local linear trend: Harvey,
Forecasting, Structural Time Series Models and the Kalman Filter, 1989, sections 2.3, 3.2 and 3.4), for each of a grid
of ratios q / r and s / r. Each pair has the probability that its likelihood gives it, with r integrated out under the
prior 1 / r, so that level and slope have a Student t distribution (West & Harrison, Bayesian Forecasting and Dynamic
Models, 1997, section 4.5). All pairs are equally likely beforehand.

Given level, slope and q, the time at which a Brownian motion with drift first reaches a limit has an inverse Gaussian
distribution (Cox & Miller, The Theory of Stochastic Processes, 1965, section 5.7; Chhikara & Folks, The Inverse
Gaussian Distribution, 1989). The drift is the mean slope of the next n nights, which deviates from that of the last
night with the variance s n / 3: the walk of the slope is replaced by a straight path to the same place. The
distribution is averaged over a lattice of `_NODES` values of all unknowns, which is the same in every call
(Niederreiter, Random Number Generation and Quasi-Monte Carlo Methods, 1992).

With two limits, the probability is the sum of those of either limit, an upper bound: a value that reaches both is
counted twice. It is too large by at most 0.09 for a walk without slope in the middle between them, and by next to
nothing if the slope or the nearer limit decides.

The probability is that of the true value without the error of measurement of a later night. Nothing is said about the
time beyond `SPANS_AHEAD` times the observed span.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import gammaincinv, log_ndtr, logsumexp, ndtr, ndtri

from twin.arrays import Array
from twin.errors import DataError
from twin.monitoring.drift import is_determined

MIN_VALUES = 8
"""Smallest number of values, without outliers, from which a probability is computed."""
SPANS_AHEAD = 2.0
"""Horizon of a forecast, as a multiple of the time between the first and the last value used."""
MOST_VALUES = 120
"""Number of the latest values that are used: what an older one says about the slope of today is doubtful."""
LOW, HIGH = 0.05, 0.95
"""Probabilities at the ends of the range of dates, and of the band of values."""

_WALKS = np.concatenate(([0.0], np.geomspace(1e-3, 1e2, 6)))
_TURNS = np.geomspace(1e-7, 1e-2, 6)
_WALK, _TURN = (ratios.ravel() for ratios in np.meshgrid(_WALKS, _TURNS))
"""Ratios q / r and s / r, shape (k,) each, per night, for standard uncertainties whose root mean square is 1."""
_NODES = 512
_TIMES = 80
_DIFFUSE = 1e8  # variance of the level before its first value, relative to r
_LEAST_WALK = 1e-10  # variance of a walk over the horizon, relative to the squares of room and movement
_LEAST_ROOM = 1e-100  # below it, the limit is reached: its square must not vanish
_NEIGHBOURS = 3  # values on each side with which a value is compared
_OUTLIER = 5.0  # robust standard deviations
_MAD_SIGMA = 1.4826  # of a normal distribution: standard deviation by median absolute deviation


@dataclass(frozen=True, eq=False)
class LimitForecast:
    """Forecast of a value that must stay below `limit`.

    `nights`, shape (k,), are nights after the last measured one, from 0 to the horizon. For each of them, `probability`
    is the probability that the limit has been reached by then (with two limits an upper bound of it). `low`, `middle`
    and `high` are the quantiles 5 %, 50 % and 95 % of the true value in that night, in the unit of the values. Each
    array has shape (k,).
    """

    limit: float
    nights: Array
    probability: Array
    low: Array
    middle: Array
    high: Array

    @property
    def horizon(self) -> float:
        """Last night, after the last measured one, about which something is said."""
        return float(self.nights[-1])

    def within(self, nights: float) -> float:
        """Return the probability that the limit is reached within `nights` nights, or within the horizon if that is
        shorter."""
        return float(np.interp(nights, self.nights, self.probability))

    def nights_to(self, probability: float) -> float | None:
        """Return the number of nights within which the limit is reached with this `probability`, or None if it is not
        reached with it within the horizon."""
        if probability > self.probability[-1]:
            return None
        return float(np.interp(probability, self.probability, self.nights))


def forecast_limit(
    nights: ArrayLike,
    values: ArrayLike,
    sigmas: ArrayLike,
    limit: float,
    steps: Sequence[float] = (),
    *,
    two_sided: bool,
) -> LimitForecast | None:
    """Forecast when the `values` measured in n `nights` will reach `limit`.

    The nights ascend. `sigmas` contains the standard uncertainties of the values, of which only the ratios count. These
    three arrays have shape (n,). `steps` contains the times, in nights, at which a new level begins. If `two_sided`,
    the limits are `limit` and -`limit`; otherwise `limit` is the only one, an upper one. Returns None if the values are
    too few or their nights do not determine a slope. Raises DataError if the input is invalid.
    """
    t, y, u = (np.asarray(given, dtype=np.float64)[-MOST_VALUES:] for given in (nights, values, sigmas))
    _check(t, y, u, limit)
    if len(t) < MIN_VALUES:
        return None
    levels = np.searchsorted(np.sort(steps), t, side="right")
    used = _used(y, u, levels)
    t, y, u, levels = t[used], y[used], u[used], levels[used]
    changes = [float(t[place + 1]) for place in np.flatnonzero(np.diff(levels))]
    if len(t) < MIN_VALUES + len(changes) or not is_determined(t, changes):
        return None
    ahead = SPANS_AHEAD * float(t[-1] - t[0]) * np.linspace(0.0, 1.0, _TIMES) ** 2  # denser in the near future
    nodes = _Nodes.of(_Filtered.of(t, y, u / np.sqrt(np.mean(u**2)), levels))
    slopes = nodes.slopes(ahead)
    probability = passage_probability(limit - nodes.level, slopes, nodes.rate, ahead)
    if two_sided:
        below = passage_probability(limit + nodes.level, -slopes, nodes.rate, ahead)
        probability = np.minimum(probability + below, 1.0)
    low, middle, high = np.quantile(nodes.values(ahead), (LOW, 0.5, HIGH), axis=0)
    return LimitForecast(float(limit), ahead, np.maximum.accumulate(probability.mean(axis=0)), low, middle, high)


def _used(y: Array, u: Array, levels: NDArray[np.intp]) -> NDArray[np.bool_]:
    """Return True for each of n values that is no outlier, shape (n,).

    A value is compared with the median of its neighbours on the same level, which a walk or a slope leaves less far
    behind than an outlier. The last two values are always used: they may be the first ones of a new level.
    """
    apart = np.zeros_like(y)
    for place in range(len(y)):
        near = np.arange(max(place - _NEIGHBOURS, 0), min(place + _NEIGHBOURS + 1, len(y)))
        near = near[(levels[near] == levels[place]) & (near != place)]
        apart[place] = (y[place] - np.median(y[near])) / u[place] if near.size else 0.0
    robust_sigma = _MAD_SIGMA * float(np.median(np.abs(apart)))
    used = np.abs(apart) <= _OUTLIER * robust_sigma if robust_sigma > 0.0 else np.ones(len(y), dtype=bool)
    used[-2:] = True
    return np.asarray(used)


@dataclass(frozen=True, eq=False)
class _Filtered:
    """Level and slope at the last night for each of k pairs of ratios q / r and s / r, each field with the shape (k,).

    The variances and the covariance are relative to `variance`, the estimate of r with `freedom` degrees of freedom.
    `probability` is that of the pair.
    """

    level: Array
    slope: Array
    level_variance: Array
    slope_variance: Array
    covariance: Array
    variance: Array
    probability: Array
    freedom: int

    @classmethod
    def of(cls, t: Array, y: Array, u: Array, levels: NDArray[np.intp]) -> _Filtered:
        """Return what the values `y` of n nights say. `u` are their standard uncertainties, with a root mean square of
        1; each argument has the shape (n,)."""
        unit, span, start = float(np.std(y)) or 1.0, float(t[-1] - t[0]), float(y[0])
        scaled, at = (y - start) / unit, (t - t[-1]) / span
        m, b, c = (np.zeros(len(_WALK)) for _ in range(3))
        p, v = (np.full(len(_WALK), _DIFFUSE) for _ in range(2))
        squares, logs = np.zeros(len(_WALK)), np.zeros(len(_WALK))
        walk, turn = _WALK * span, _TURN * span**3
        for place, value in enumerate(scaled):
            gap = at[place] - at[place - 1] if place else 0.0
            # the level walks and moves by the slope; ((p, c), (c, v)) is the covariance of both
            m = m + gap * b
            p = p + 2.0 * gap * c + gap**2 * v + walk * gap + turn * gap**3 / 3.0
            c, v = c + gap * v + 0.5 * turn * gap**2, v + turn * gap
            if place and levels[place] != levels[place - 1]:
                p = p + _DIFFUSE
            spread, missed = p + u[place] ** 2, value - m
            squares, logs = squares + missed**2 / spread, logs + np.log(spread)
            of_level, of_slope = p / spread, c / spread
            m, b = m + of_level * missed, b + of_slope * missed
            p, c, v = p - of_level * p, c - of_level * c, v - of_slope * c
        freedom = len(y) - 1 - len(np.unique(levels))
        relative = np.maximum(squares, np.finfo(np.float64).eps) / freedom
        weights = -0.5 * (logs + freedom * np.log(relative))
        probability = np.exp(weights - logsumexp(weights))
        rate = unit / span
        return cls(
            start + unit * m, rate * b, p, v / span**2, c / span, unit**2 * relative, np.asarray(probability), freedom
        )


@dataclass(frozen=True, eq=False)
class _Nodes:
    """Equally likely values of the level and slope at the last night, of the variances per night q (`rate`) and s
    (`turn`), and of the standard normal deviations of the mean slope of later nights (`turned`) and of a later value
    from its line (`deviation`), each with the shape (_NODES,)."""

    level: Array
    slope: Array
    rate: Array
    turn: Array
    turned: Array
    deviation: Array

    @classmethod
    def of(cls, known: _Filtered) -> _Nodes:
        lattice = _lattice(6)
        ratio = np.searchsorted(np.cumsum(known.probability)[:-1], lattice[0])
        # r = (estimate of r) f / χ² with f degrees of freedom
        variance = known.variance[ratio] * known.freedom / (2.0 * gammaincinv(0.5 * known.freedom, lattice[1]))
        first, second, turned, deviation = ndtri(lattice[2:])
        sigma, slope_sigma = np.sqrt(variance), np.sqrt(known.slope_variance)[ratio]
        share = known.covariance[ratio] / slope_sigma
        beside = np.sqrt(np.maximum(known.level_variance[ratio] - share**2, 0.0))
        level = known.level[ratio] + sigma * (share * first + beside * second)
        slope = known.slope[ratio] + sigma * slope_sigma * first
        return cls(level, slope, variance * _WALK[ratio], variance * _TURN[ratio], turned, deviation)

    def slopes(self, ahead: Array) -> Array:
        """Return the mean slopes of the nodes over the next `ahead` (k,) nights, shape (_NODES, k)."""
        found: Array = self.slope[:, None] + np.sqrt(self.turn[:, None] * ahead / 3.0) * self.turned[:, None]
        return found

    def values(self, ahead: Array) -> Array:
        """Return the values of the nodes `ahead` (k,) nights later, shape (_NODES, k)."""
        walked = np.sqrt(self.rate[:, None] * ahead) * self.deviation[:, None]
        found: Array = self.level[:, None] + self.slopes(ahead) * ahead + walked
        return found


def passage_probability(room: Array, slope: Array, rate: Array, ahead: Array) -> Array:
    """Return the probability that a Brownian motion has reached `room` above its start within `ahead` nights.

    `room` and `rate`, its variance per night, have the shape (m,). `ahead`, shape (k,), ascends from 0 or more to the
    horizon, which is above 0. `slope`, its mean drift over so many nights, and the result have the shape (m, k).
    """
    horizon = float(ahead[-1])
    moved = slope * ahead
    reached, started = room <= _LEAST_ROOM, ahead > 0.0
    a = np.where(reached, 1.0, room)
    least = _LEAST_WALK * (a**2 + moved[:, -1] ** 2) / horizon  # a line without walk is its limit
    a, q = a[:, None], np.maximum(rate, least)[:, None]
    sigma = np.sqrt(q * np.where(started, ahead, horizon))
    back = np.minimum(2.0 * slope * a / q + log_ndtr(-(moved + a) / sigma), 0.0)
    found = np.where(started, ndtr((moved - a) / sigma) + np.exp(back), 0.0)
    return np.where(reached[:, None], 1.0, np.minimum(found, 1.0))


@cache
def _lattice(dimensions: int) -> Array:
    """Return `_NODES` points that fill the unit cube evenly, shape (dimensions, _NODES): multiples of 1/g, 1/g², … for
    the root g of g^(dimensions + 1) = g + 1."""
    root = 2.0
    for _ in range(50):
        root = (1.0 + root) ** (1.0 / (dimensions + 1))
    steps = root ** -np.arange(1.0, dimensions + 1.0)
    found: Array = (0.5 + np.outer(steps, np.arange(1.0, _NODES + 1.0))) % 1.0
    return found


def _check(t: Array, y: Array, u: Array, limit: float) -> None:
    if not len(t) == len(y) == len(u):
        raise DataError("a forecast needs as many times as values and uncertainties")
    if not (np.isfinite(t).all() and np.isfinite(y).all() and (u > 0.0).all() and np.isfinite(u).all()):
        raise DataError("times and values must be finite, uncertainties above zero")
    if (np.diff(t) < 0.0).any():
        raise DataError("the nights are not in order")
    if not (np.isfinite(limit) and limit > 0.0):
        raise DataError(f"a limit must be above zero, not {limit:g}")
