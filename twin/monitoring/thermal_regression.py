"""Drift between nights explained by temperatures of the machine: which sensors explain it, and by how much per kelvin.

The values of each direction are modelled as levels, effects of the temperatures, a random walk and errors
(`drift_evidence`). The marginal likelihood is averaged over a grid of the walk q and of the ridge g. A direction
responds to the temperatures with the probability ω, over which the product of all directions is averaged too. Each set
of sensors has this evidence; a sensor is taken only if it multiplies the evidence by at least `ODDS` (Jeffreys' scale:
strong; Kass & Raftery, JASA 90, 1995). Sensors that explain nothing lower the evidence, so none of them may be taken.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import logsumexp

from twin.arrays import Array
from twin.errors import DataError
from twin.monitoring.drift_evidence import RIDGES, WALKS, DriftDirection, NightlyDrift, level_columns, walk_covariance

ODDS = 20.0
"""Factor by which a sensor must multiply the evidence to be taken."""

_SHARES = np.array([0.05, 0.2, 0.5, 0.9])  # ω
_EVEN = 0.5
_ALL = 1.0 - 1e-9  # ω behind a stated uncertainty: every machine responds a little, and directions mix its errors
_ALONE = 0.5  # spread of bodies relative to the change of a sensor that is alone
_NEGLIGIBLE = 1e-4  # probability of a model that is not averaged


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
    found = [DriftDirection.of(drift, place) for place in range(drift.values.shape[1])]
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


def _log_evidence(directions: Sequence[DriftDirection], chosen: tuple[int, ...]) -> tuple[float, float]:
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


def _models(one: DriftDirection, chosen: tuple[int, ...], share: float) -> tuple[list[_Model], Array]:
    """Return the models of a direction and their probabilities (m,)."""
    walks = range(len(WALKS))
    models, logs = [_Model(q, (), 1.0) for q in walks], one.log_evidence(()).ravel()
    if chosen:
        models += [_Model(q, chosen, float(g)) for q in walks for g in RIDGES]
        responding = one.log_evidence(chosen).ravel() + math.log(share / len(RIDGES))
        logs = np.concatenate([logs + math.log1p(-share), responding])
    return models, np.exp(logs - logsumexp(logs))


def _posterior(
    one: DriftDirection, chosen: tuple[int, ...], share: float, scale_k: float
) -> tuple[Array, Array, float]:
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
    walk = float(weights @ (factors * WALKS[[model.walk for model in models]]))
    return mean / scale_k, covariance / scale_k**2, walk


def _left_out(drift: NightlyDrift, place: int, one: DriftDirection, chosen: tuple[int, ...]) -> Array:
    """Return the differences of the nights from their prediction by all other nights, for the likeliest model.

    With P = V⁻¹ - V⁻¹F(FᵀV⁻¹F)⁻¹FᵀV⁻¹ they are (P y)_k / P_kk (Dubrule, Mathematical Geology 15, 1983), where V
    contains the prior of the coefficients.
    """
    models, weights = _models(one, chosen, _EVEN)
    model = models[int(np.argmax(weights))]
    variances, days = drift.variances[one.nights, place], drift.days[one.nights]
    unit = float(np.median(variances))
    covariance = walk_covariance(days, variances / unit, float(WALKS[model.walk]))
    if model.sensors:
        x = drift.scaled[one.nights][:, model.sensors]
        covariance = covariance + model.ridge * x @ x.T
    levels = level_columns(days, drift.steps)
    inverse = np.linalg.inv(covariance)
    side = inverse @ levels
    projector = inverse - side @ np.linalg.solve(levels.T @ side, side.T)
    with np.errstate(divide="ignore", invalid="ignore"):  # a night that is alone on its level is not predicted
        differences = (projector @ drift.values[one.nights, place]) / np.diag(projector)
    alone = np.diag(projector) <= 1e-9 * np.diag(inverse)
    return np.where(alone, np.nan, differences)
