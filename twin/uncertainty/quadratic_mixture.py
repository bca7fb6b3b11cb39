"""Distribution of a quadratic form of Gaussian variables with several possible means and covariances.

Each possible pair of mean and covariance is equally probable.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq
from scipy.special import ndtri

from twin.errors import DataError
from twin.uncertainty.quadratic_distribution import QuadraticDistribution

_LEAST_SPREAD = 1e-9  # relative standard deviation below which rounding decides


@dataclass(frozen=True, eq=False)
class QuadraticMixture:
    """Distribution of a quadratic form Q as a mixture of the distributions `parts`, which have equal weights."""

    parts: tuple[QuadraticDistribution, ...]

    @property
    def mean(self) -> float:
        return float(np.mean([part.mean for part in self.parts]))

    @property
    def variance(self) -> float:
        return float(np.mean([part.variance + part.mean**2 for part in self.parts])) - self.mean**2

    def exceeds(self, value: float) -> float:
        """Return the probability that the quadratic form Q is greater than `value`."""
        return float(np.mean([part.exceeds(value) for part in self.parts]))

    def at_most(self, value: float) -> float:
        """Return the probability that the quadratic form Q is at most `value`."""
        return float(np.mean([part.at_most(value) for part in self.parts]))

    def quantile(self, probability: float) -> float:
        """Return the value that the quadratic form Q does not exceed with the given probability.

        Raises DataError if `probability` is not between 0 and 1.
        """
        if not 0.0 < probability < 1.0:
            raise DataError(f"the probability must lie between 0 and 1, not {probability}")
        # The search begins at the quantile of the log-normal distribution with the same mean and variance.
        spread = math.sqrt(math.log1p(max(self.variance / self.mean**2, _LEAST_SPREAD**2)))
        lower = upper = self.mean * math.exp(spread * (float(ndtri(probability)) - 0.5 * spread))
        widening = math.exp(0.2 * spread)
        while self.at_most(lower) >= probability:
            lower, widening = lower / widening, widening**1.5
        while self.at_most(upper) <= probability:
            upper, widening = upper * widening, widening**1.5
        root: float = brentq(lambda value: self.at_most(value) - probability, lower, upper, xtol=1e-12 * upper)
        return root
