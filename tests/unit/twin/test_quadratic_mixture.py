"""Mixture of quadratic forms against sampling."""

from __future__ import annotations

import numpy as np
import pytest

from twin.errors import DataError
from twin.uncertainty.quadratic_distribution import QuadraticDistribution
from twin.uncertainty.volumetric_distribution import QuadraticMixture

NARROW = QuadraticDistribution.of(np.eye(3), np.zeros(3), 0.5, np.zeros(3), np.eye(3))
WIDE = QuadraticDistribution.of(np.eye(3), np.zeros(3), 0.0, np.ones(3), 4.0 * np.eye(3))
BOTH = QuadraticMixture((NARROW, WIDE))


def drawn() -> np.ndarray:
    rng = np.random.default_rng(8)
    narrow = 0.5 + np.sum(rng.normal(size=(40000, 3)) ** 2, axis=1)
    wide = np.sum((1.0 + 2.0 * rng.normal(size=(40000, 3))) ** 2, axis=1)
    return np.concatenate((narrow, wide))


def test_moments_and_probabilities_are_those_of_drawn_values() -> None:
    values = drawn()
    assert BOTH.mean == pytest.approx(values.mean(), rel=0.02)
    assert BOTH.variance == pytest.approx(values.var(), rel=0.05)
    for limit in (1.0, 4.0, 20.0):
        assert BOTH.at_most(limit) == pytest.approx(np.mean(values <= limit), abs=0.01)
        assert BOTH.exceeds(limit) == pytest.approx(1.0 - BOTH.at_most(limit), abs=1e-9)


@pytest.mark.parametrize("probability", [0.025, 0.5, 0.975])
def test_quantiles_lead_back(probability: float) -> None:
    assert BOTH.at_most(BOTH.quantile(probability)) == pytest.approx(probability, abs=1e-9)


def test_a_mixture_of_one_is_that_one() -> None:
    assert QuadraticMixture((WIDE, WIDE)).quantile(0.3) == pytest.approx(WIDE.quantile(0.3), rel=1e-9)


@pytest.mark.parametrize("probability", [1e-12, 1.0 - 1e-12])
def test_quantiles_far_out_lead_back(probability: float) -> None:
    rare = min(probability, 1.0 - probability)
    of_tail = BOTH.at_most if probability < 0.5 else BOTH.exceeds
    assert of_tail(BOTH.quantile(probability)) == pytest.approx(rare, rel=1e-3)


@pytest.mark.parametrize("probability", [0.0, 1e-310, 1e-13, 1.0 - 1e-13, 1.0 - 1.2e-16, 1.0, -0.1, float("nan")])
def test_what_rounding_hides_has_no_quantile(probability: float) -> None:
    with pytest.raises(DataError, match="probability must lie between"):
        BOTH.quantile(probability)


@pytest.mark.parametrize("probability", [0.025, 0.975])
def test_a_spread_near_rounding_is_resolved(probability: float) -> None:
    """One squared normal variable of 10⁻¹² above 10⁻³."""
    tight = QuadraticMixture((QuadraticDistribution(np.array([1e-12]), np.array([0.0]), 1e-3),))
    assert tight.at_most(tight.quantile(probability)) == pytest.approx(probability, abs=2e-3)
