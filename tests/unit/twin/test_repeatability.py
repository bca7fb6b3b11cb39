"""Repeatability of a few readings compared with scipy.stats and with many trials."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import chi2

from twin.artefact.repeatability import estimate_repeatability
from twin.errors import DataError


def test_interval_is_that_of_the_chi_squared_distribution() -> None:
    readings = [1.0, 2.0, 4.0, 4.5, 7.0]
    scatter = estimate_repeatability(readings)
    assert scatter.sigma == pytest.approx(np.std(readings, ddof=1))
    assert scatter.lower == pytest.approx(scatter.sigma * np.sqrt(4 / chi2.ppf(0.975, 4)))
    assert scatter.upper == pytest.approx(scatter.sigma * np.sqrt(4 / chi2.ppf(0.025, 4)))
    edge = scatter.sigma * np.sqrt(4 / chi2.ppf(0.99, 4))
    assert scatter.exceeds(0.999 * edge, 0.99)
    assert not scatter.exceeds(1.001 * edge, 0.99)


def test_the_interval_holds_the_truth_as_often_as_it_says_and_a_good_probe_is_rarely_refused() -> None:
    rng = np.random.default_rng(1)
    trials = [estimate_repeatability(list(row)) for row in rng.normal(0.0, 1.0, (4000, 5))]
    assert np.mean([t.lower <= 1.0 <= t.upper for t in trials]) == pytest.approx(0.95, abs=0.012)
    assert np.mean([t.exceeds(1.0, 0.99) for t in trials]) == pytest.approx(0.01, abs=0.006)


def test_one_reading_does_not_scatter() -> None:
    with pytest.raises(DataError, match="have no standard deviation"):
        estimate_repeatability([1.0])
