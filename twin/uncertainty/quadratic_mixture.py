"""The distribution of a quadratic form whose covariance is one of several."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq

from twin.uncertainty.quadratic_distribution import QuadraticDistribution


@dataclass(frozen=True, eq=False)
class QuadraticMixture:
    """One of several `parts`, each as likely as any other."""

    parts: tuple[QuadraticDistribution, ...]

    @property
    def mean(self) -> float:
        return float(np.mean([part.mean for part in self.parts]))

    @property
    def variance(self) -> float:
        return float(np.mean([part.variance + part.mean**2 for part in self.parts])) - self.mean**2

    def exceeds(self, value: float) -> float:
        """Probability that Q > value."""
        return float(np.mean([part.exceeds(value) for part in self.parts]))

    def at_most(self, value: float) -> float:
        """Probability that Q ≤ value."""
        return float(np.mean([part.at_most(value) for part in self.parts]))

    def quantile(self, probability: float) -> float:
        """Value that Q stays below with this probability. DataError unless it lies between 0 and 1."""
        ends = [part.quantile(probability) for part in self.parts]
        lower, upper = min(ends) * (1.0 - 1e-9), max(ends) * (1.0 + 1e-9)  # a bracket that rounding cannot spoil
        root: float = brentq(lambda value: self.at_most(value) - probability, lower, upper, xtol=1e-12 * upper)
        return root
