"""Marginal likelihood of the drift of one direction of the error model, given the temperatures of some sensors.

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
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular

from twin.arrays import Array
from twin.errors import DataError

MIN_NIGHTS = 8
"""Smallest number of nights from which a drift is explained."""
MOST_SENSORS = 4
WALKS = np.concatenate(([0.0], np.geomspace(1e-3, 30.0, 8)))
"""Grid of q per day, for stated variances of about 1."""
RIDGES = np.geomspace(0.1, 1e5, 7)
"""Grid of g, for temperatures that are scaled to rms 1."""

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
        return int(self.temperatures_c.shape[1])

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
class DriftDirection:
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
    def of(cls, drift: NightlyDrift, place: int) -> DriftDirection | None:
        """Return None if too few nights saw the direction."""
        nights = np.flatnonzero(np.isfinite(drift.variances[:, place]))
        if len(nights) < MIN_NIGHTS:
            return None
        days, variances = drift.days[nights], drift.variances[nights, place]
        levels = level_columns(days, drift.steps)
        freedom = len(nights) - levels.shape[1]
        if freedom < MIN_NIGHTS - 1:
            return None
        unit = float(np.median(variances))  # the grid of q is meant for variances of about 1
        columns = np.column_stack([levels, drift.values[nights, place], math.sqrt(unit) * drift.scaled[nights]])
        forms = [_whitened(walk_covariance(days, variances / unit, q), columns, levels.shape[1]) for q in WALKS]
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
        grown = 1.0 + RIDGES[:, None] * values
        left = self._bounded(self.square[:, None] - (RIDGES[:, None] * turned**2 / grown).sum(axis=2))
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


def level_columns(days: Array, steps: Sequence[float]) -> Array:
    """Return the columns (n, l) of the levels that have values."""
    number = np.searchsorted(np.sort(steps), days, side="right")
    return np.asarray(number[:, None] == np.unique(number), dtype=np.float64)


def walk_covariance(days: Array, variances: Array, walk: float) -> Array:
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
