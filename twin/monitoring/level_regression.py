"""Weighted linear regression on levels with one common slope, solved by sums over each level.

The model is that of `twin.monitoring.drift`: y_i = m_l + slope (t_i - t_n) for a value on level l, where t_n is the
last night. With weights w_i = 1 / u_i², the means t_l and y_l of each level and the deviations d_i = t_i - t_l, the
normal equations separate (within-group estimator, analysis of covariance):

    slope = Σ w_i d_i (y_i - y_l) / S with S = Σ w_i d_i²,  and  m_l = y_l - slope (t_l - t_n).

The work is therefore proportional to the number of values, however many levels there are.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from twin.arrays import Array


@dataclass(frozen=True, eq=False)
class LevelRegression:
    """Regression of n values on k + 1 levels that are separated by k steps, and a common slope.

    `levels`, shape (n,), contains the index of the level of each value. `weights`, shape (n,), contains 1 / u_i, and
    `totals`, shape (k + 1,), the sum of their squares on each level. `means`, shape (k + 1,), contains the mean night
    of each level, counted from the last night, and `deviations`, shape (n,), the nights counted from that mean.
    `spread` is the weighted sum S of their squares; it is 0 if no level has values of different nights, in which case
    the slope is not determined and is set to 0. `intercepts`, shape (k + 1,), contains the values m_l. `fitted`, shape
    (n,), contains the fitted values, and `residuals`, shape (n,), what is left of the values, divided by their standard
    uncertainties.
    """

    levels: NDArray[np.intp]
    weights: Array
    totals: Array
    means: Array
    deviations: Array
    spread: float
    slope: float
    intercepts: Array
    fitted: Array
    residuals: Array

    @classmethod
    def of(cls, t: Array, y: Array, sigmas: Array, steps: Sequence[float]) -> LevelRegression:
        """Return the regression of the values `y` of the ascending nights `t`, each with the shape (n,). The `steps`
        are in any order; there is a value on each level."""
        levels = np.searchsorted(np.sort(steps), t, side="right")
        weights = 1.0 / sigmas
        squares = weights**2
        nights = t - t[-1]

        def level_sums(terms: Array) -> Array:
            return np.bincount(levels, terms, len(steps) + 1).astype(np.float64)

        totals = level_sums(squares)
        means, y_means = level_sums(squares * nights) / totals, level_sums(squares * y) / totals
        deviations = nights - means[levels]
        spread = float((squares * deviations) @ deviations)
        slope = float((squares * deviations) @ (y - y_means[levels])) / spread if spread > 0.0 else 0.0
        intercepts = y_means - slope * means
        fitted = y_means[levels] + slope * deviations
        residuals = weights * (y - fitted)
        return cls(levels, weights, totals, means, deviations, spread, slope, intercepts, fitted, residuals)

    @property
    def leverages(self) -> Array:
        """Diagonal of the projection on the columns of the regression, shape (n,)."""
        found: Array = self.weights**2 / self.totals[self.levels] + self._slope_column**2
        return found

    @property
    def _slope_column(self) -> Array:
        """Column of the slope, orthogonal to the levels and of length 1, or zeros if the slope is not determined."""
        if self.spread <= 0.0:
            return np.zeros_like(self.weights)
        column: Array = self.weights * self.deviations / np.sqrt(self.spread)
        return column

    def step_columns(self, candidates: NDArray[np.intp]) -> tuple[Array, Array, Array]:
        """Return three products for a further step before each of the values with the indices `candidates`, each with
        the shape (n_candidates,). The column of a step contains the weights of the values of its level before it.

        They are the square of the column, the square of its part that is orthogonal to the regression, and the product
        of this part with the residuals. Values of earlier levels are left out, since the regression contains these
        levels.
        """
        last_before = candidates - 1
        sums = np.concatenate(([0.0], np.cumsum(self.weights**2)))
        starts = np.searchsorted(self.levels, self.levels[last_before])  # first value of the level
        square = sums[candidates] - sums[starts]
        # The sums of these over a whole level are 0, so that they begin anew on each level.
        slope_share = np.cumsum(self.weights * self._slope_column)[last_before]
        explained = np.cumsum(self.weights * self.residuals)[last_before]
        orthogonal = square - square**2 / self.totals[self.levels[last_before]] - slope_share**2
        return square, orthogonal, explained

    def step_column(self, at: int) -> Array:
        """Return the part of the column of a step before the value `at` that is orthogonal to the regression, with
        length 1, shape (n,)."""
        level = self.levels[at - 1]
        same = self.levels == level
        before = same & (np.arange(len(self.weights)) < at)
        share = float(np.sum(self.weights[before] ** 2)) / self.totals[level]
        column = np.where(same, self.weights * (before - share), 0.0)
        column = column - self._slope_column * (self._slope_column @ column)
        found: Array = column / np.linalg.norm(column)
        return found
