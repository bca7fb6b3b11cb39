"""Alarms about a tolerance where the forecast is short: few values, or a warning beyond its horizon."""

from __future__ import annotations

import re

import numpy as np
import pytest

from agent.history.series import Series
from agent.history.trends import SHORT_HISTORY, AlarmKind, Trend, trend_of
from agent.language.sentences import german

S_PER_DAY = 86_400.0
START_S = 1_700_000_000.0
"""2023-11-14 22:13:20 UTC"""


def series(nights: np.ndarray, values: np.ndarray, tolerance: float) -> Series:
    return Series(
        name="ve_bare", title="VE", unit="µm", run_ids=tuple(map(str, range(len(values)))), nights=nights,
        values=values, sigmas=np.full(len(values), 0.05), stated=True, tolerance=tolerance, two_sided=False, steps=(),
        started_s=START_S + S_PER_DAY * nights,
    )  # fmt: skip


def told(trend: Trend) -> list[str]:
    return [alarm.text for alarm in trend.alarms if alarm.kind is AlarmKind.TREND]


@pytest.mark.parametrize(
    ("between", "count", "slope", "left", "warn_nights"),
    [(1.0, 8, 1.0, 20.0, 60.0), (1.0 / 24.0, 12, 1.2, 1.2, 14.0), (0.5, 10, 0.4, 10.3, 14.0)],
)
def test_a_line_that_reaches_the_tolerance_beyond_the_forecast_raises_an_alarm(
    between: float, count: int, slope: float, left: float, warn_nights: float
) -> None:
    """The measured line has `left` nights to go, more than twice the time that was observed."""
    nights = between * np.arange(count)
    values = 10.0 + slope * nights + 0.02 * np.random.default_rng(1).standard_normal(count)
    trend = trend_of(series(nights, values, 10.0 + slope * (nights[-1] + left)), warn_nights)
    assert trend.forecast is not None
    assert trend.forecast.horizon < left
    assert trend.forecast.within(warn_nights) < 0.5
    [text] = told(trend)
    assert text.startswith("VE grows by ")
    said = re.search(r"tolerance \S+ µm reached in (\d+) nights$", text)
    assert said is not None
    assert int(said[1]) == pytest.approx(left, abs=1.0 + 0.1 * left)


def test_a_probability_is_stated_for_nights_that_the_forecast_reaches() -> None:
    nights = np.arange(10.0)
    values = 10.0 + 0.3 * nights + 0.05 * np.random.default_rng(2).standard_normal(10)
    trend = trend_of(series(nights, values, 16.0), 30.0)
    [text] = told(trend)
    assert text.endswith(" % within 18 nights")
    stated = trend.as_json()["forecast"]
    assert (stated["warn_nights"], stated["within_nights"]) == (30.0, 18.0)
    assert trend_of(series(nights, values, 16.0), 14.0).as_json()["forecast"]["within_nights"] == 14.0


def test_a_short_history_of_a_machine_that_does_not_move_raises_few_alarms() -> None:
    """The tolerance is three standard deviations away. A slope is significant by chance in 5 % of the histories."""
    rng, count, found = np.random.default_rng(5), SHORT_HISTORY // 2, 0
    for _ in range(40):
        values = 10.0 + 0.3 * rng.standard_normal(count)
        found += values[-1] < 10.9 and bool(told(trend_of(series(np.arange(float(count)), values, 10.9), 14.0)))
    assert found <= 3


def test_a_date_beyond_the_forecast_is_not_named_as_the_middle() -> None:
    nights = np.arange(30.0)
    values = 10.0 + 0.02 * nights + 0.3 * np.random.default_rng(1).standard_normal(30)
    for tolerance in np.arange(10.6, 12.0, 0.1):
        trend = trend_of(series(nights, values, float(tolerance)), 60.0, 0.1)
        if trend.forecast is not None and trend.forecast.nights_to(0.5) is None and told(trend):
            break
    [text] = told(trend)
    assert re.search(r"tolerance \S+ µm may be reached from 202\d-\d\d-\d\d on \(5 %\), \d+ % within 58 nights$", text)
    assert re.search(
        r"Toleranz \S+ µm kann ab \d\d\.\d\d\.202\d erreicht werden \(5 %\), mit \d+ % in den nächsten 58 Nächten$",
        german(text),
    )
