"""Forecasts and alarms of the program, compared with what happened in seasons that share no code with it."""

from __future__ import annotations

import argparse
import json
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np

from agent.history.series import Series
from agent.history.trends import AlarmKind, Trend, trend_of
from campaigns.seasons.machine_season import MachineSeason, season
from twin.monitoring.limit_forecast import HIGH, LOW
from twin.units import S_PER_DAY

FIRST = 10_000
"""Number of the first season; those with lower numbers served to choose the constants of the forecast."""
WARN_NIGHTS = 14.0
HORIZONS = (14.0, 30.0, 60.0)
CLASSES = (0.0, 0.1, 0.5, 1.0)
"""Ends of the classes of stated probabilities."""
_FIRST_NIGHT, _LAST_NIGHTS, _CUTS, _EVERY = 30, 61, 2, 7
_LEAST_RUNS = 10


@dataclass(frozen=True)
class Forecast:
    """Forecast made in one night of a season, and what happened.

    `probabilities` are those of reaching the tolerance within each of `HORIZONS`, None beyond the horizon of the
    forecast. `low`, `middle` and `high` are the nights to 5 %, 50 % and 95 %, None if the forecast names none. `left`
    is the true number of nights, infinite if the season ended before, and `seen` that until the end of the season.
    """

    probabilities: tuple[float | None, ...]
    low: float | None
    middle: float | None
    high: float | None
    left: float
    seen: float


def trend_at(one: MachineSeason, night: float) -> Trend | None:
    """Return the trend that the program shows in a night, None if there are too few runs or the tolerance seemed to be
    reached already."""
    nights, values = one.until(night)
    if len(nights) < _LEAST_RUNS or abs(values[-1]) >= one.limit:
        return None
    names = tuple(f"{night:.0f}" for night in nights)
    unknown = np.ones_like(values)
    series = Series(
        "EXX[1]", "EXX slope", "µm", names, nights, values, unknown, False, one.limit, True, (), S_PER_DAY * nights
    )
    return trend_of(series, WARN_NIGHTS)


def forecasts(number: int) -> Iterable[Forecast]:
    """Yield the forecasts of the program in two random nights of the season with this number, before the tolerance is
    reached."""
    one, rng = season(number), np.random.default_rng([9, number])
    end = min(one.passed, len(one.true) - _LAST_NIGHTS)
    if end <= _FIRST_NIGHT:
        return
    for night in rng.integers(_FIRST_NIGHT, int(end), _CUTS).tolist():
        trend = trend_at(one, night)
        if trend is None or trend.forecast is None:
            continue
        found, last = trend.forecast, float(trend.series.nights[-1])
        probabilities = tuple(found.within(ahead) if ahead <= found.horizon else None for ahead in HORIZONS)
        low, middle, high = (found.nights_to(probability) for probability in (LOW, 0.5, HIGH))
        yield Forecast(probabilities, low, middle, high, one.passed - last, len(one.true) - 1 - last)


def calibration(judged: Sequence[Forecast]) -> list[dict[str, Any]]:
    """Return how many forecasts of each horizon and class of probability there are, how many tolerances should be
    reached by the sum of their probabilities, and how many were."""
    rows: list[dict[str, Any]] = []
    for place, ahead in enumerate(HORIZONS):
        stated = [(one.probabilities[place], one.left <= ahead) for one in judged]
        for low, high in pairwise(CLASSES):
            chosen = [(p, reached) for p, reached in stated if p is not None and low <= p and (p < high or high == 1.0)]
            expected = sum(p for p, _ in chosen)
            doubt = math.sqrt(sum(p * (1.0 - p) for p, _ in chosen))
            rows.append(
                {
                    "nights": ahead,
                    "from": low,
                    "to": high,
                    "count": len(chosen),
                    "expected": round(expected, 1),
                    "sigma": round(doubt, 1),
                    "reached": sum(reached for _, reached in chosen),
                }
            )
    return rows


def coverage(judged: Sequence[Forecast]) -> dict[str, Any]:
    """Return in how many of the forecasts that name a date the tolerance was reached before, within and after the range
    from 5 % to 95 %. A range without an end has none; forecasts that the season is too short to judge are left out."""
    before = inside = after = 0
    for one in judged:
        low, high = one.low, math.inf if one.high is None else one.high
        if one.middle is None or low is None or (math.isinf(one.left) and one.seen < high):
            continue
        before, inside, after = before + (one.left < low), inside + (low <= one.left <= high), after + (one.left > high)
    return {"forecasts": before + inside + after, "before": before, "inside": inside, "after": after}


def alarms(numbers: Sequence[int]) -> dict[str, Any]:
    """Return how the alarms by the probability, and those by the fitted line alone, announced the tolerances of seasons
    judged once a week.

    An alarm is early if the true value reaches the tolerance within twice the time of the warning, and false if it does
    so later or not at all.
    """
    checks, reached = 0, 0
    rules = ("probability", "line")
    counts = {rule: {"right": 0, "early": 0, "false": 0, "seasons_with_false": 0, "announced": 0} for rule in rules}
    for number in numbers:
        one = season(number)
        end = min(one.passed, len(one.true) - _LAST_NIGHTS)
        false, announced = dict.fromkeys(rules, False), dict.fromkeys(rules, False)
        for night in range(_FIRST_NIGHT, math.ceil(end), _EVERY):
            trend = trend_at(one, night)
            if trend is None:
                continue
            checks += 1
            left = one.passed - float(trend.series.nights[-1])
            kind = "right" if left <= WARN_NIGHTS else "early" if left <= 2.0 * WARN_NIGHTS else "false"
            for rule, raised in zip(rules, (_by_probability(trend), _by_line(trend)), strict=True):
                counts[rule][kind] += raised
                false[rule] |= raised and kind == "false"
                announced[rule] |= raised and kind != "false"
        passed = _FIRST_NIGHT + WARN_NIGHTS < one.passed <= len(one.true) - _LAST_NIGHTS
        reached += passed
        for rule in rules:
            counts[rule]["seasons_with_false"] += false[rule]
            counts[rule]["announced"] += announced[rule] and passed
    return {"seasons": len(numbers), "reached": reached, "checks": checks, **counts}


def _by_probability(trend: Trend) -> bool:
    return any(alarm.kind is AlarmKind.TREND for alarm in trend.alarms)


def _by_line(trend: Trend) -> bool:
    significant = trend.drift is not None and trend.drift.significant
    return significant and trend.crossing is not None and trend.crossing.expected <= WARN_NIGHTS


def main(arguments: Sequence[str] | None = None) -> int:
    """Judge forecasts and alarms, and print the counts as one line of JSON."""
    parser = argparse.ArgumentParser(prog="python -m campaigns.seasons", description=__doc__)
    parser.add_argument("--seasons", type=int, default=600, help="seasons in which forecasts are judged")
    parser.add_argument("--alarmed", type=int, default=100, help="seasons of which alarms are judged every week")
    parser.add_argument("--first", type=int, default=FIRST, help="number of the first season")
    asked = parser.parse_args(arguments)
    numbers = range(asked.first, asked.first + asked.seasons)
    judged = [one for number in numbers for one in forecasts(number)]
    found = {"forecasts": len(judged), "calibration": calibration(judged), "coverage": coverage(judged)}
    print(json.dumps(found | {"alarms": alarms(numbers[: asked.alarmed])}))
    return 0
