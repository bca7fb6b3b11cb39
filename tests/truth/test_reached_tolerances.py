"""Stated probabilities and dates of reached tolerances come true in seasons that share no code with the program."""

from __future__ import annotations

import numpy as np
import pytest

from campaigns.seasons.judged_forecasts import FIRST, WARN_NIGHTS, Forecast, calibration, coverage, forecasts, trend_at
from campaigns.seasons.machine_season import MachineSeason, season

SEASONS = 90
SIGMAS = 3.0


@pytest.fixture(scope="module")
def judged() -> list[Forecast]:
    return [one for number in range(FIRST, FIRST + SEASONS) for one in forecasts(number)]


def test_as_many_tolerances_are_reached_as_stated(judged: list[Forecast]) -> None:
    for row in calibration(judged):
        assert abs(row["reached"] - row["expected"]) <= SIGMAS * row["sigma"] + 1.0, row


def test_the_stated_range_contains_the_date(judged: list[Forecast]) -> None:
    found = coverage(judged)
    assert found["forecasts"] >= 30
    assert 0.85 <= found["inside"] / found["forecasts"] <= 1.0


def test_a_certain_forecast_is_made_too(judged: list[Forecast]) -> None:
    """A probability that is always the same would be as well calibrated."""
    soon = [one.probabilities[1] for one in judged if one.probabilities[1] is not None and one.left <= 30.0]
    late = [one.probabilities[1] for one in judged if one.probabilities[1] is not None and one.left > 30.0]
    assert np.mean(soon) > 0.6
    assert np.mean(late) < 0.1


def test_alarms_of_a_machine_that_does_not_wear_are_rare() -> None:
    """Noise alone, far from the tolerance and near it: weekly judged over half a year."""
    for number in range(6):
        rng = np.random.default_rng([10, number])
        nights = np.arange(180.0)
        level = 3.0 + 0.5 * number
        one = MachineSeason(np.full(180, level), nights, level + 0.4 * rng.standard_normal(180), 8.0)
        trends = [trend_at(one, night) for night in range(30, 180, 14)]
        assert not any(
            trend is not None and trend.forecast and trend.forecast.within(WARN_NIGHTS) > 0.5 for trend in trends
        )


def test_seasons_are_the_same_again_and_differ() -> None:
    assert np.array_equal(season(3).measured, season(3).measured)
    assert season(3).limit != season(4).limit
