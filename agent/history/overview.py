"""Trends of the results of one machine, the selection of trends to be shown, and the alarms of the trends."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

from agent.history.dated_ahead import ahead_text
from agent.history.schema import StoredRun
from agent.history.series import ACTIVE, BARE, HELD_OUT, Series, all_series
from agent.history.trends import AlarmKind, Trend, TrendAlarm, trend_of
from agent.settings.history import HistorySettings
from drivers.errors import InputError

VOLUMETRIC = (BARE, ACTIVE, HELD_OUT)
_MOST_SHOWN = 6


def trends_of(runs: Sequence[StoredRun], settings: HistorySettings, known: Sequence[Trend] = ()) -> tuple[Trend, ...]:
    """Return the trends of all series of values that are computed from the runs of one machine.

    The runs must be sorted, with the oldest run first, and none dated in the future. Of the trends `known`, made
    before with the same settings, those whose series has not changed are returned as they are.
    """
    before = {trend.series.name: trend for trend in known}
    made = partial(trend_of, warn_nights=settings.warn_nights, warn_probability=settings.warn_probability)

    def trend(series: Series) -> Trend:
        same = before.get(series.name)
        return same if same is not None and series.same_as(same.series) else made(series)

    return tuple(trend(series) for series in all_series(runs, settings))


def select_trends(trends: Sequence[Trend], names: Sequence[str]) -> tuple[Trend, ...]:
    """Return those of `trends` whose series have the given names.

    The name of a geometric error such as `EXX` also selects the trends of its Legendre coefficients. Raises InputError
    if there is no series with one of the names.
    """
    by_name = {trend.series.name: trend for trend in trends}
    found: dict[str, Trend] = {}
    for name in names:
        same = {known: trend for known, trend in by_name.items() if known == name or known.startswith(f"{name}[")}
        if not same:
            listed = ", ".join(list(by_name)[:24]) or "none yet"
            raise InputError(f"no run has a series {name!r}", hint=f"known series: {listed}")
        found |= same
    return tuple(found.values())


def most_relevant(trends: Sequence[Trend], most: int = _MOST_SHOWN) -> tuple[Trend, ...]:
    """Return at most `most` trends, the most relevant trends first.

    The trends of the volumetric errors and of the held-out balls come first, in the order of `trends`. Of the other
    trends, those with a tolerance come before those without. In each of these two groups, trends with an alarm come
    first. Trends that are still equal are sorted by the significance of their drift, the most significant first.
    """
    volumetric = [trend for trend in trends if trend.series.name in VOLUMETRIC]
    others = [trend for trend in trends if trend.series.name not in VOLUMETRIC]
    others.sort(key=lambda trend: (trend.series.tolerance is None, not trend.alarms, -_significance(trend)))
    return tuple((volumetric + others)[:most])


def alarms_of(trends: Sequence[Trend], ahead: Sequence[StoredRun] = ()) -> tuple[TrendAlarm, ...]:
    """Return the alarms of three kinds of trends: those of the volumetric errors, of the held-out balls, and of all
    series with a tolerance. The last alarm names the runs that are dated in the future (`ahead`), if there are any.

    Other alarms are omitted, because among a hundred coefficients of the error model some exceed their control limits
    by chance.
    """
    of_trends = (
        alarm
        for trend in trends
        if trend.series.name in VOLUMETRIC or trend.series.tolerance is not None
        for alarm in trend.alarms
    )
    of_dates = [TrendAlarm("", AlarmKind.DATE, ahead_text(ahead))] if ahead else []
    return (*of_trends, *of_dates)


def _significance(trend: Trend) -> float:
    drift = trend.drift
    return 0.0 if drift is None or drift.slope_sigma == 0.0 else abs(drift.slope) / drift.slope_sigma
