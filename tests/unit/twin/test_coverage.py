"""Regions and observed coverage, on errors of known distribution."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from twin.uncertainty.coverage import joint_level, observed_coverage, two_sided_level


def test_levels_are_those_of_the_normal_distribution() -> None:
    assert two_sided_level(np.array([0.0, -1.959964, 1.959964, 0.674490])) == pytest.approx(
        [0.0, 0.95, 0.95, 0.5], abs=1e-6
    )


def test_joint_levels_are_even_where_the_covariance_is_right_and_rise_where_it_is_too_small() -> None:
    rng = np.random.default_rng(1)
    factor = rng.normal(size=(9, 6))
    covariance = factor @ factor.T
    drawn = factor @ rng.normal(size=(6, 1500))
    levels = np.array([joint_level(error, covariance) for error in drawn.T])
    assert stats.kstest(levels, "uniform").pvalue > 0.01
    assert np.mean([joint_level(error, covariance / 1.5**2) <= 0.95 for error in drawn.T]) < 0.75


def test_a_joint_level_is_that_of_the_distance_in_units_of_the_covariance() -> None:
    covariance = np.array([[2.0, 0.6], [0.6, 1.0]])
    error = np.array([1.5, -0.7])
    distance = error @ np.linalg.inv(covariance) @ error
    assert joint_level(error, covariance) == pytest.approx(stats.chi2(2).cdf(distance), rel=1e-9)


def test_the_standard_error_of_single_comparisons_is_binomial() -> None:
    levels = [np.array([0.5])] * 180 + [np.array([0.99])] * 20
    share = observed_coverage(levels, 0.95, np.random.default_rng(2))
    assert share.observed == 0.9
    assert share.standard_error == pytest.approx(np.sqrt(0.9 * 0.1 / 200), rel=0.08)


def test_comparisons_of_one_machine_count_as_going_together() -> None:
    """A hundred identical comparisons count as one."""
    alike = [np.full(100, 0.5)] * 90 + [np.full(100, 0.99)] * 10
    share = observed_coverage(alike, 0.95, np.random.default_rng(3))
    assert share.observed == 0.9
    assert share.standard_error == pytest.approx(np.sqrt(0.9 * 0.1 / 100), rel=0.08)
