"""Distribution of a quadratic form of Gaussian variables with several possible means and covariances.

Each possible pair of mean and covariance is equally probable.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq

from twin.uncertainty.quadratic_distribution import QuadraticDistribution


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
        ends = [part.quantile(probability) for part in self.parts]
        lower, upper = (
            min(ends) * (1.0 - 1e-9),
            max(ends) * (1.0 + 1e-9),
        )  # widened so that rounding cannot exclude the root
        root: float = brentq(lambda value: self.at_most(value) - probability, lower, upper, xtol=1e-12 * upper)
        return root
