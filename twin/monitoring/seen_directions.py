"""Few directions of an error model that the measurements see, ordered by how much they see.

Of p parameters with the covariance C after a measurement and the covariance Σ before it (that of the family of
machines), the generalised eigenvectors Σ v = μ C v are the combinations that are independent both before and after the
measurement (simultaneous diagonalisation; Golub & Van Loan, Matrix Computations, 4th ed., section 8.7). μ is the ratio
of the two variances. With C = L Lᵀ and L⁻¹ Σ L⁻ᵀ = V μ Vᵀ, the coordinates u = Vᵀ L⁻¹ z have the variance 1 after the
measurement, and the parameters that belong to them are z = L V u. Directions with a small μ are left out: they follow
from the prior.

The directions depend on covariances alone and on no measured value, so that choosing them does not bias what is found.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from twin.arrays import Array
from twin.errors import DataError

MOST_DIRECTIONS = 16
LEAST_GAIN = 4.0
"""Smallest ratio of the variances before and after the measurement of a direction that is seen."""


@dataclass(frozen=True, eq=False)
class SeenDirections:
    """The d directions of p parameters that measurements see best.

    `analysis` (d, p) gives the coordinates u = analysis @ z of parameters z, in standard deviations of a measurement.
    `synthesis` (p, d) gives the parameters that belong to coordinates, and `gains` (d,) the ratios μ of the variances
    before and after a measurement, the largest first.
    """

    analysis: Array
    synthesis: Array
    gains: Array

    @classmethod
    def of(cls, covariance: ArrayLike, expected: ArrayLike, most: int = MOST_DIRECTIONS) -> SeenDirections:
        """Return the directions seen by measurements with the covariance `covariance` (p, p) of machines whose
        parameters have the covariance `expected` (p, p) beforehand, in the same units. Raises DataError if the
        covariance is singular or no direction is seen."""
        after, before = (np.asarray(one, dtype=np.float64) for one in (covariance, expected))
        # The family holds some parameters at zero: they are known before and after.
        free = np.flatnonzero((np.diag(before) > 0.0) & (np.diag(after) > 0.0))
        try:
            factor = np.linalg.cholesky(after[np.ix_(free, free)])
        except np.linalg.LinAlgError:
            raise DataError("the covariance of the estimates is singular") from None
        half = np.linalg.solve(factor, before[np.ix_(free, free)])
        gains, vectors = np.linalg.eigh(np.linalg.solve(factor, half.T))
        chosen = np.argsort(gains)[::-1][:most]
        chosen = chosen[gains[chosen] >= LEAST_GAIN]
        if not chosen.size:
            raise DataError("the measurements determine no error of the machine better than its family does")
        analysis, synthesis = np.zeros((len(chosen), len(after))), np.zeros((len(after), len(chosen)))
        analysis[:, free] = np.linalg.solve(factor.T, vectors[:, chosen]).T
        synthesis[free] = factor @ vectors[:, chosen]
        return cls(analysis, synthesis, gains[chosen])


def own_measurement(
    value: ArrayLike, variance: ArrayLike, prior_value: ArrayLike, prior_variance: ArrayLike
) -> tuple[Array, Array]:
    """Return value and variance (d,) of what a night itself measured, if its estimate was fused with a prior.

    A Gaussian posterior is the product of prior and likelihood: 1/c = 1/r + 1/p and u/c = y/r + m/p, solved for y and
    r. The variance is infinite, and the value NaN, where the night has learned nothing of a coordinate.
    """
    u, c, m, p = (np.asarray(one, dtype=np.float64) for one in (value, variance, prior_value, prior_variance))
    information = 1.0 / c - 1.0 / p
    seen = information > _LEAST_LEARNED / p
    safe = np.where(seen, information, 1.0)
    return np.where(seen, (u / c - m / p) / safe, np.nan), np.where(seen, 1.0 / safe, np.inf)


_LEAST_LEARNED = 0.05  # of the information of the prior: below it, y is the difference of two nearly equal numbers
