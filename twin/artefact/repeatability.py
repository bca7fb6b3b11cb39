"""Repeatability of readings: their standard deviation and its confidence interval."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from scipy.special import gammaincinv

from twin.errors import DataError


@dataclass(frozen=True)
class RepeatabilityEstimate:
    """Sample standard deviation `sigma` of `count` readings, in the unit of the readings, with its confidence interval.

    If the readings are normally distributed and independent, the true standard deviation is between `lower` and `upper`
    with the probability `confidence`.
    """

    sigma: float
    count: int
    confidence: float
    lower: float
    upper: float

    def exceeds(self, limit: float, confidence: float) -> bool:
        """Return True if the true standard deviation exceeds `limit` with the one-sided confidence level
        `confidence`.
        """
        return self.sigma * _factor(confidence, self.count - 1) > limit


def estimate_repeatability(readings: Sequence[float], confidence: float = 0.95) -> RepeatabilityEstimate:
    """Estimate the repeatability of at least two readings, with a two-sided confidence interval.

    The limits of the interval are s·√(ν / χ²). Here s is the sample standard deviation, ν is its number of degrees of
    freedom, and χ² is a quantile of the chi-square distribution. Raises DataError if there are fewer than two readings.
    """
    count = len(readings)
    if count < 2:
        raise DataError(f"{count} readings have no standard deviation", hint="two or more are needed")
    mean = math.fsum(readings) / count
    sigma = math.sqrt(math.fsum((value - mean) ** 2 for value in readings) / (count - 1))
    tail = 0.5 * (1.0 - confidence)
    lower, upper = (sigma * _factor(share, count - 1) for share in (1.0 - tail, tail))
    return RepeatabilityEstimate(sigma, count, confidence, lower, upper)


def _factor(probability: float, freedom: int) -> float:
    """Return √(ν / χ²), where χ² is the quantile at `probability` of the chi-square distribution.

    ν (`freedom`) is its number of degrees of freedom.
    """
    return math.sqrt(freedom / (2.0 * float(gammaincinv(0.5 * freedom, probability))))
