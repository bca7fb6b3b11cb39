"""Drift between nights explained by temperatures of the machine: which sensors explain it, and by how much per kelvin.

In each of d directions of the error model (module `seen_directions`), the values y of n nights are modelled as

    y = F a + X b + w + e,   w: random walk with the variance σ² q per day,   e: error with the variance σ² r_k,

where F has one column for each level between known sudden changes, X (n, s) contains the temperatures of the sensors in
question, r_k are the stated variances, and σ² is their unknown common factor. This is generalised least squares with
the covariance V = diag(r) + q min(t_i, t_j) (Rao, Linear Statistical Inference, 2nd ed., section 4a.2). The random walk
keeps two quantities that merely wander from being taken for cause and effect (spurious regression: Granger & Newbold,
Journal of Econometrics 2, 1974).

a has a flat prior, σ² the prior 1/σ², and b the prior N(0, σ² g I), a ridge that also keeps coefficients of collinear
sensors finite. All of them can be integrated out (West & Harrison, Bayesian Forecasting and Dynamic Models, 1997,
chapter 4; O'Hagan & Forster, Bayesian Inference, 2nd ed., section 11). With y and X whitened by V and freed from F, and
G = XᵀX, c = Xᵀy, the marginal likelihood is, up to a constant of the direction,

    ln p = -½ ln|V| - ½ ln|FᵀV⁻¹F| - ½ ln|I + g G| - ½ (n - l) ln(yᵀy - cᵀ(G + I/g)⁻¹c).

It is averaged over a grid of q and g. A direction responds to the temperatures with the probability ω, over which the
product of all directions is averaged too. Each set of sensors has this evidence; a sensor is taken only if it
multiplies the evidence by at least `ODDS` (Jeffreys' scale: strong; Kass & Raftery, JASA 90, 1995). Sensors that
explain nothing lower the evidence, so none of them may be taken.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import solve_triangular
from scipy.special import logsumexp

from twin.arrays import Array
from twin.errors import DataError

MIN_NIGHTS = 8
"""Smallest number of nights from which a drift is explained."""
MOST_SENSORS = 4
ODDS = 20.0
"""Factor by which a sensor must multiply the evidence to be taken."""

_WALKS = np.concatenate(([0.0], np.geomspace(1e-3, 30.0, 8)))  # q per day; the stated variances are about 1
_RIDGES = np.geomspace(0.1, 1e5, 7)  # g for temperatures that are scaled to rms 1
_SHARES = np.array([0.05, 0.2, 0.5, 0.9])  # ω
_EVEN = 0.5
_ALL = 1.0 - 1e-9  # ω behind a stated uncertainty: every machine responds a little, and directions mix its errors
_ALONE = 0.5  # spread of bodies relative to the change of a sensor that is alone
_NEGLIGIBLE = 1e-4  # probability of a model that is not averaged
_LEAST_SQUARE = 1e-12  # of the squares without a model: values that a model meets exactly


@dataclass(frozen=True, eq=False)
class NightlyDrift:
    """Values measured in n nights in d directions, and the temperatures of s sensors.

    `days` (n,) ascends. `values` and `variances` (n, d) are in units of the directions; a variance is infinite if the
    night did not see the direction. `temperatures_c` (n, s) has no gaps. `steps` contains the days at which a new level
    begins. Raises DataError if the nights are too few or the input is invalid.
    """

    days: Array
    values: Array
    variances: Array
    temperatures_c: Array
    steps: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        count = len(self.days)
        if count < MIN_NIGHTS:
            raise DataError(
                f"{count} nights with an estimate and with temperatures are too few to explain a drift",
                hint=f"{MIN_NIGHTS} nights are needed, and a season of temperatures tells more",
            )
        if not (self.values.shape == self.variances.shape and len(self.values) == count == len(self.temperatures_c)):
            raise DataError("values, variances and temperatures must have one row for each night")
        if self.temperatures_c.shape[1] > MOST_SENSORS:
            raise DataError(f"{self.temperatures_c.shape[1]} sensors are too many, at most {MOST_SENSORS}")
        if (np.diff(self.days) < 0.0).any() or not np.isfinite(self.days).all():
            raise DataError("the nights are not in order")
        if not np.isfinite(self.temperatures_c).all() or not (self.variances > 0.0).all():
            raise DataError("temperatures must be finite, variances above zero")

    @property
    def sensors(self) -> int:
        return self.temperatures_c.shape[1]

    @property
    def scale_k(self) -> float:
        """Rms in K of the temperatures about the mean of their sensor; the unit in which the prior of b is stated."""
        centred = self.temperatures_c - self.temperatures_c.mean(axis=0)
        found = float(np.sqrt(np.mean(centred**2))) if centred.size else 0.0
        return found or 1.0

    @property
    def scaled(self) -> Array:
        """Temperatures (n, s) about the mean of their sensor, in units of `scale_k`."""
        return np.asarray((self.temperatures_c - self.temperatures_c.mean(axis=0)) / self.scale_k)


@dataclass(frozen=True, eq=False)
class _Direction:
    """One direction: the nights that saw it (m,), and for each of k values of q its whitened form without its levels.

    `log_base` (k,) is the part of ln p without sensors, `freedom` is n - l, `square` (k,) is yᵀy, `gram` (k, s, s) is G
    and `product` (k, s) is c.
    """

    nights: NDArray[np.intp]
    log_base: Array
    freedom: int
    square: Array
    gram: Array
    product: Array

    @classmethod
    def of(cls, drift: NightlyDrift, place: int) -> _Direction | None:
        """Return None if too few nights saw the direction."""
        nights = np.flatnonzero(np.isfinite(drift.variances[:, place]))
        if len(nights) < MIN_NIGHTS:
            return None
        days, variances = drift.days[nights], drift.variances[nights, place]
        levels = _levels(days, drift.steps)
        freedom = len(nights) - levels.shape[1]
        if freedom < MIN_NIGHTS - 1:
            return None
        unit = float(np.median(variances))  # the grid of q is meant for variances of about 1
        columns = np.column_stack([levels, drift.values[nights, place], math.sqrt(unit) * drift.scaled[nights]])
        forms = [_whitened(_covariance(days, variances / unit, q), columns, levels.shape[1]) for q in _WALKS]
        log_base, rest = np.array([base for base, _ in forms]), np.array([one for _, one in forms])
        # The temperatures were multiplied with the unit, so that g is in units of the stated variances.
        moments = rest.transpose(0, 2, 1) @ rest
        return cls(
            nights, log_base, freedom, moments[:, 0, 0], moments[:, 1:, 1:] / unit, moments[:, 1:, 0] / unit**0.5
        )

    def log_evidence(self, chosen: Sequence[int]) -> Array:
        """Return ln p (k, g) for all ridges and the sensors with these indices; (k, 1) without a sensor."""
        if not chosen:
            return (self.log_base - 0.5 * self.freedom * np.log(self._bounded(self.square)))[:, None]
        values, vectors = np.linalg.eigh(self.gram[:, chosen][:, :, chosen])
        values = np.maximum(values, 0.0)[:, None, :]
        turned = np.einsum("kij,ki->kj", vectors, self.product[:, chosen])[:, None, :]
        # I + g G in its own axes
        grown = 1.0 + _RIDGES[:, None] * values
        left = self._bounded(self.square[:, None] - (_RIDGES[:, None] * turned**2 / grown).sum(axis=2))
        found = self.log_base[:, None] - 0.5 * np.log(grown).sum(axis=2) - 0.5 * self.freedom * np.log(left)
        return np.asarray(found)

    def coefficients(self, q: int, chosen: Sequence[int], ridge: float) -> tuple[Array, Array, float]:
        """Return mean (s,) and covariance (s, s) of the coefficients, zero for sensors not chosen, and σ²."""
        size = self.product.shape[1]
        mean, covariance = np.zeros(size), np.zeros((size, size))
        square = float(self.square[q])
        if chosen:
            rows = np.ix_(chosen, chosen)
            inverse = np.linalg.inv(self.gram[q][rows] + np.eye(len(chosen)) / ridge)
            mean[list(chosen)] = inverse @ self.product[q][list(chosen)]
            square -= float(self.product[q] @ mean)
            covariance[rows] = inverse
        # Variance of a Student t distribution with m degrees of freedom: its scale, times m / (m - 2).
        factor = float(self._bounded(np.array(square))) / max(self.freedom - 2, 1)
        return mean, factor * covariance, factor

    def _bounded(self, square: Array) -> Array:
        return np.maximum(square, max(_LEAST_SQUARE * float(self.square.max()), np.finfo(float).tiny))


def _levels(days: Array, steps: Sequence[float]) -> Array:
    """Return the columns (n, l) of the levels that have values."""
    number = np.searchsorted(np.sort(steps), days, side="right")
    return np.asarray(number[:, None] == np.unique(number), dtype=np.float64)


def _covariance(days: Array, variances: Array, walk: float) -> Array:
    past = days - days[0]
    return np.asarray(np.diag(variances) + walk * np.minimum.outer(past, past))


def _whitened(covariance: Array, columns: Array, levels: int) -> tuple[float, Array]:
    """Return the part of ln p without sensors, and the columns (n, 1 + s) of values and temperatures, whitened and
    freed from the first `levels` columns."""
    factor = np.linalg.cholesky(covariance)
    white = solve_triangular(factor, columns, lower=True, check_finite=False)
    basis, triangle = np.linalg.qr(white[:, :levels])
    rest = white[:, levels:] - basis @ (basis.T @ white[:, levels:])
    log_base = -float(np.log(np.diag(factor)).sum()) - float(np.log(np.abs(np.diag(triangle))).sum())
    return log_base, rest


@dataclass(frozen=True, eq=False)
class ThermalFit:
    """Drift of d directions explained by temperatures.

    `taken` contains the indices of the sensors that explain it, ascending; it is empty if none does. `log_evidence` is
    that of the sensors taken against no sensor, and `log_gain` (s,) what each sensor adds to (or would add to) the
    evidence of the other ones taken.

    `coefficients` (d, s) are in units of a direction per K, zero for sensors not taken. `covariances` (d, s, s) are
    their expected squared errors under the model with all sensors: nights that never saw two sensors apart leave open
    which of them matters, also if one of them suffices to explain the nights. `walk` (d,) is the variance per day of
    the random walk that remains. `reference_c` (s,) is the mean temperature of each sensor. `left_out` and
    `left_out_without` (n, d) are the differences of each night from the prediction by all other nights, with the
    sensors taken and without sensors; NaN where a night did not see a direction.
    """

    drift: NightlyDrift
    taken: tuple[int, ...]
    log_evidence: float
    log_gain: Array
    coefficients: Array
    covariances: Array
    walk: Array
    reference_c: Array
    left_out: Array
    left_out_without: Array

    def change(self, difference_k: ArrayLike, sigmas_k: ArrayLike, days: float = 0.0) -> tuple[Array, Array]:
        """Return the expected change (d,) of the directions if the temperatures change by `difference_k` (s,) in K
        within so many days, and its variance (d,): that of the coefficients, of the readings with the standard
        uncertainties `sigmas_k` (s,) in K, and of the random walk."""
        difference, sigmas = (np.asarray(one, dtype=np.float64) for one in (difference_k, sigmas_k))
        variance = np.einsum("i,dij,j->d", difference, self.covariances, difference)
        variance += self.coefficients**2 @ sigmas**2 + self._mean_square_effect * _spread_k2(difference)
        return self.coefficients @ difference, np.asarray(variance + self.walk * abs(days))

    @property
    def _mean_square_effect(self) -> Array:
        """Mean square (d,) over the sensors of the effect of a body per K."""
        squares = self.coefficients**2 + np.einsum("dss->ds", self.covariances)
        return np.asarray(squares.mean(axis=1))


def _spread_k2(difference: Array) -> float:
    """Return the variance in K² of the temperature changes of bodies, of which the sensors show a few.

    The machine has bodies without a sensor, such as the head. One that is exchangeable with the sensed ones has an
    effect of the same mean square, and its temperature departs from what the sensors say by their own spread.
    """
    if len(difference) > 1:
        return float(np.var(difference, ddof=1))
    return float((_ALONE * difference[0]) ** 2)


def explain_drift(drift: NightlyDrift) -> ThermalFit:
    """Explain the drift by the sensors that the evidence supports. Raises DataError if too few nights saw any of the
    directions."""
    found = [_Direction.of(drift, place) for place in range(drift.values.shape[1])]
    directions = [one for one in found if one is not None]
    if not directions:
        raise DataError("too few nights have seen the same errors of the machine", hint="measure the same positions")
    everything = range(drift.sensors)
    sets = [chosen for size in range(drift.sensors + 1) for chosen in combinations(everything, size)]
    evidence = {chosen: _log_evidence(directions, chosen) for chosen in sets}
    taken = max(sets, key=lambda chosen: evidence[chosen][0] - math.log(ODDS) * len(chosen))
    gains = [evidence[_with(taken, place)][0] - evidence[_without(taken, place)][0] for place in everything]
    count, size = len(found), drift.sensors
    means, covariances, walk = np.zeros((count, size)), np.zeros((count, size, size)), np.zeros(count)
    left_out = np.full((2, *drift.values.shape), np.nan)
    for place, one in enumerate(found):
        if one is None:
            continue
        means[place], _, walk[place] = _posterior(one, taken, evidence[taken][1], drift.scale_k)
        whole = tuple(everything)
        expected, covariances[place], _ = _posterior(one, whole, _ALL, drift.scale_k)
        covariances[place] += np.multiply.outer(expected - means[place], expected - means[place])
        for row, chosen in enumerate((taken, ())):
            left_out[row, one.nights, place] = _left_out(drift, place, one, chosen)
    return ThermalFit(
        drift,
        taken,
        evidence[taken][0] - evidence[()][0],
        np.array(gains),
        means,
        covariances,
        walk,
        drift.temperatures_c.mean(axis=0),
        left_out[0],
        left_out[1],
    )


def _with(taken: tuple[int, ...], place: int) -> tuple[int, ...]:
    return tuple(sorted({*taken, place}))


def _without(taken: tuple[int, ...], place: int) -> tuple[int, ...]:
    return tuple(one for one in taken if one != place)


def _log_evidence(directions: Sequence[_Direction], chosen: tuple[int, ...]) -> tuple[float, float]:
    """Return the log evidence of a set of sensors, and the likeliest share ω of directions that respond."""
    none = np.array([_mean_log(one.log_evidence(())) for one in directions])
    if not chosen:
        return float(none.sum()), 0.0
    with_sensors = np.array([_mean_log(one.log_evidence(chosen)) for one in directions])
    shares = np.logaddexp(np.log1p(-_SHARES)[:, None] + none, np.log(_SHARES)[:, None] + with_sensors).sum(axis=1)
    return _mean_log(shares), float(_SHARES[np.argmax(shares)])


def _mean_log(logs: ArrayLike) -> float:
    values = np.asarray(logs, dtype=np.float64)
    return float(logsumexp(values) - math.log(values.size))


@dataclass(frozen=True)
class _Model:
    """One model of a direction: the index of its q, its sensors and its g."""

    walk: int
    sensors: tuple[int, ...]
    ridge: float


def _models(one: _Direction, chosen: tuple[int, ...], share: float) -> tuple[list[_Model], Array]:
    """Return the models of a direction and their probabilities (m,)."""
    walks = range(len(_WALKS))
    models, logs = [_Model(q, (), 1.0) for q in walks], one.log_evidence(()).ravel()
    if chosen:
        models += [_Model(q, chosen, float(g)) for q in walks for g in _RIDGES]
        responding = one.log_evidence(chosen).ravel() + math.log(share / len(_RIDGES))
        logs = np.concatenate([logs + math.log1p(-share), responding])
    return models, np.exp(logs - logsumexp(logs))


def _posterior(one: _Direction, chosen: tuple[int, ...], share: float, scale_k: float) -> tuple[Array, Array, float]:
    """Return mean (s,) and covariance (s, s) of the coefficients per K and the variance of the walk per day, averaged
    over all models of the direction."""
    models, weights = _models(one, chosen, share)
    heavy = np.flatnonzero(weights > _NEGLIGIBLE)
    models, weights = [models[at] for at in heavy], weights[heavy] / weights[heavy].sum()
    parts = [one.coefficients(model.walk, model.sensors, model.ridge) for model in models]
    means, factors = np.array([mean for mean, _, _ in parts]), np.array([factor for _, _, factor in parts])
    mean = weights @ means
    away = means - mean
    covariance = np.einsum("m,mij->ij", weights, np.array([each for _, each, _ in parts]))
    covariance += np.einsum("m,mi,mj->ij", weights, away, away)
    walk = float(weights @ (factors * _WALKS[[model.walk for model in models]]))
    return mean / scale_k, covariance / scale_k**2, walk


def _left_out(drift: NightlyDrift, place: int, one: _Direction, chosen: tuple[int, ...]) -> Array:
    """Return the differences of the nights from their prediction by all other nights, for the likeliest model.

    With P = V⁻¹ - V⁻¹F(FᵀV⁻¹F)⁻¹FᵀV⁻¹ they are (P y)_k / P_kk (Dubrule, Mathematical Geology 15, 1983), where V
    contains the prior of the coefficients.
    """
    models, weights = _models(one, chosen, _EVEN)
    model = models[int(np.argmax(weights))]
    variances, days = drift.variances[one.nights, place], drift.days[one.nights]
    unit = float(np.median(variances))
    covariance = _covariance(days, variances / unit, float(_WALKS[model.walk]))
    if model.sensors:
        x = drift.scaled[np.ix_(one.nights, model.sensors)]
        covariance = covariance + model.ridge * x @ x.T
    levels = _levels(days, drift.steps)
    inverse = np.linalg.inv(covariance)
    side = inverse @ levels
    projector = inverse - side @ np.linalg.solve(levels.T @ side, side.T)
    with np.errstate(divide="ignore", invalid="ignore"):  # a night that is alone on its level is not predicted
        differences = (projector @ drift.values[one.nights, place]) / np.diag(projector)
    alone = np.diag(projector) <= 1e-9 * np.diag(inverse)
    return np.where(alone, np.nan, differences)
