"""Trend of a series of values from night to night: the drift per night, the control limits, and the alarms.

An alarm can be raised before the quantity reaches its tolerance.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from datetime import datetime
from enum import Enum
from typing import Any

import numpy as np

from agent.history.series import Series
from twin.errors import DataError
from twin.monitoring import (
    Drift,
    EwmaChart,
    IndividualsChart,
    LimitCrossing,
    ewma_chart,
    find_steps,
    fit_drift,
    individuals_chart,
    limit_crossing,
)
from twin.monitoring.drift import MIN_FREEDOM_FOR_SCALE
from twin.monitoring.limit_forecast import HIGH, LOW, LimitForecast, forecast_limit

HORIZON_NIGHTS = 3650.0
MIN_CHARTED = 8
WARN_PROBABILITY = 0.5
"""Probability of reaching a tolerance within the nights of a warning with which an alarm is raised."""
SHORT_HISTORY = 16
"""Number of values below which a probability raises an alarm only if the slope is significant: of a constant value,
eight or twelve values that scatter often give a slope by chance."""
_COURSE_DIGITS = 4


class AlarmKind(Enum):
    """Kind of an alarm about the trend of a value.

    `LIMIT` means that the value has reached its tolerance. `TREND` means that it will reach its tolerance soon.
    `CONTROL` means that the newest value, or the smoothed mean of the values, is outside its control limits.
    `DATE` is no alarm of a trend: a run is dated in the future (`agent.history.dated_ahead`), and does not count.
    """

    LIMIT = "limit"
    TREND = "trend"
    CONTROL = "control"
    DATE = "date"

    @property
    def of_tolerance(self) -> bool:
        """Return True if a tolerance has been reached or will be soon."""
        return self in (AlarmKind.LIMIT, AlarmKind.TREND)


@dataclass(frozen=True)
class TrendAlarm:
    """Alarm about the trend of the series `series`, an empty text for an alarm about a date. `nights` is the number of
    nights until the tolerance is reached, None for an alarm that is not about a tolerance."""

    series: str
    kind: AlarmKind
    text: str
    nights: float | None = None


@dataclass(frozen=True, eq=False)
class Trend:
    """Trend of a series.

    `drift` is the fitted change per night; it is None if there are too few values. `chart` and `smoothed` are control
    charts of the values, and of their exponentially weighted mean, since the last sudden change (step). Both are None
    if there are fewer than `MIN_CHARTED` (8) such values. `crossing` predicts the time at which the series will reach
    its tolerance; it is None if there is no tolerance or no drift. `forecast` contains the probability of this; it is
    None if there is no tolerance, if it is already reached, or if there are too few values. `warn_nights` is the time
    of a warning, for which the probability is stated unless the forecast ends before.
    """

    series: Series
    drift: Drift | None
    chart: IndividualsChart | None
    smoothed: EwmaChart | None
    crossing: LimitCrossing | None
    forecast: LimitForecast | None
    warn_nights: float
    alarms: tuple[TrendAlarm, ...]

    @property
    def nights_stated(self) -> float:
        """Nights after the last run for which the probability is stated: those of a warning, or the horizon of the
        forecast if that is shorter."""
        return self.warn_nights if self.forecast is None else min(self.warn_nights, self.forecast.horizon)

    def date_reached(self, probability: float) -> datetime | None:
        """Return the UTC time by which the tolerance is reached with this `probability`, or None if the forecast names
        none."""
        nights = None if self.forecast is None else self.forecast.nights_to(probability)
        return None if nights is None else self.series.date(float(self.series.nights[-1]) + nights)

    @property
    def dates_reached(self) -> tuple[datetime | None, datetime | None, datetime | None]:
        """UTC times by which the tolerance is reached with 5 %, 50 % and 95 %, None where the forecast names none."""
        return self.date_reached(LOW), self.date_reached(0.5), self.date_reached(HIGH)

    @property
    def days_reached(self) -> tuple[str, str, str]:
        """Days of `dates_reached` in words; "later" where the forecast names none."""
        low, middle, high = ("later" if date is None else f"{date:%Y-%m-%d}" for date in self.dates_reached)
        return low, middle, high

    def as_json(self) -> dict[str, Any]:
        """Return the trend as a mapping to be written as JSON. The keys are described in docs/reference/json.md."""
        series, drift, chart, reach = self.series, self.drift, self.chart, self.crossing
        return {
            "name": series.name,
            "title": series.title,
            "unit": series.unit,
            "runs": list(series.run_ids),
            "nights": series.nights.tolist(),
            "started": np.datetime_as_string(series.started_s.astype("datetime64[s]"), timezone="UTC").tolist(),
            "values": series.values.tolist(),
            "standard_uncertainties": series.sigmas.tolist() if series.stated else None,
            "tolerance": series.tolerance,
            "drift_a_night": None if drift is None else drift.slope,
            "drift_standard_uncertainty": None if drift is None else drift.slope_sigma,
            "significant": None if drift is None else drift.significant,
            "level": None if drift is None else drift.level,
            "steps": [] if drift is None else [{"night": at, "size": size} for at, size, _ in drift.steps],
            "control_limits": None if chart is None else [chart.lower, chart.centre, chart.upper],
            "nights_left": None if reach is None else _finite(reach.expected),
            "nights_left_at_least": None if reach is None else _finite(reach.earliest),
            "forecast": self._forecast_json(),
            "alarms": [{"kind": alarm.kind.value, "text": alarm.text} for alarm in self.alarms],
        }

    def _forecast_json(self) -> dict[str, Any] | None:
        forecast = self.forecast
        if forecast is None:
            return None
        course = {
            name: getattr(forecast, name).round(_COURSE_DIGITS).tolist()
            for name in ("nights", "probability", "low", "middle", "high")
        }
        return {
            "warn_nights": self.warn_nights,
            "within_nights": self.nights_stated,
            "probability": round(forecast.within(self.nights_stated), _COURSE_DIGITS),
            "horizon_nights": forecast.horizon,
            "dates": [None if date is None else f"{date:%Y-%m-%d}" for date in self.dates_reached],
            "nights_to": [forecast.nights_to(probability) for probability in (LOW, 0.5, HIGH)],
            "course": course,
        }


def trend_of(series: Series, warn_nights: float, warn_probability: float = WARN_PROBABILITY) -> Trend:
    """Return the trend of a series, with an alarm if its tolerance will be reached within `warn_nights` nights with a
    probability of at least `warn_probability`."""
    drift = _drift(series)
    last_step = max((at for at, _, _ in drift.steps), default=-math.inf) if drift is not None else -math.inf
    recent = series.values[series.nights >= last_step]
    chart = individuals_chart(recent) if len(recent) >= MIN_CHARTED else None
    smoothed = None if chart is None else ewma_chart(recent, chart.centre, chart.sigma)
    reach = None
    if series.tolerance is not None and drift is not None:
        reach = limit_crossing(drift, series.tolerance, HORIZON_NIGHTS, two_sided=series.two_sided)
    forecast = None if drift is None else _forecast(series, drift)
    found = Trend(series, drift, chart, smoothed, reach, forecast, warn_nights, ())
    alarms = (*_tolerance_alarm(found, warn_probability), *_control_alarm(series, chart, smoothed))
    return replace(found, alarms=alarms)


def _drift(series: Series) -> Drift | None:
    """Return the drift. Return None if there are too few nights for a fit, or if the standard uncertainties are not
    stated and there are too few nights to estimate the repeatability.
    """
    try:
        steps = find_steps(series.nights, series.values, series.sigmas, series.steps)
        drift = fit_drift(series.nights, series.values, series.sigmas, steps)
    except DataError:
        return None
    return drift if series.stated or drift.freedom >= MIN_FREEDOM_FOR_SCALE else None


def _forecast(series: Series, drift: Drift) -> LimitForecast | None:
    """Return the forecast for the tolerance of the series. Return None if there is no tolerance, if it is reached, or
    if there are too few values."""
    if series.tolerance is None or _is_at(series, series.tolerance):
        return None
    steps = [at for at, _, _ in drift.steps]
    return forecast_limit(
        series.nights, series.values, series.sigmas, series.tolerance, steps, two_sided=series.two_sided
    )


def _is_at(series: Series, tolerance: float) -> bool:
    value = float(series.values[-1])
    return (abs(value) if series.two_sided else value) >= tolerance


def _tolerance_alarm(trend: Trend, probability: float) -> Iterable[TrendAlarm]:
    """Yield an alarm if the tolerance is reached, or if it will probably be reached within the nights of a warning.

    Where the forecast does not reach as far as the warning, or where there are too few values for a probability, the
    alarm is also raised if the slope is significant and the fitted line reaches the tolerance within these nights.
    """
    series, tolerance, drift, reach = trend.series, trend.series.tolerance, trend.drift, trend.crossing
    if tolerance is None:
        return
    value = f"{series.values[-1]:.2f}"
    if _is_at(series, tolerance):
        text = f"{series.title} is {value} {series.unit}: tolerance {tolerance:g} {series.unit} reached"
        yield TrendAlarm(series.name, AlarmKind.LIMIT, text, 0.0)
    elif drift is not None and trend.forecast is not None and _is_probable(trend, drift, trend.forecast, probability):
        now = f"{series.title} amounts to {value} {series.unit}"
        text = _forecast_text(_rate_text(series, drift) if drift.significant else now, trend, trend.forecast)
        yield TrendAlarm(series.name, AlarmKind.TREND, text, trend.forecast.nights_to(0.5))
    elif drift is not None and reach is not None and _line_reaches(trend, drift, reach):
        in_nights = max(math.floor(reach.expected), 0)
        text = f"{_rate_text(series, drift)}: tolerance {tolerance:g} {series.unit} reached in {in_nights} nights"
        yield TrendAlarm(series.name, AlarmKind.TREND, text, reach.expected)


def _is_probable(trend: Trend, drift: Drift, forecast: LimitForecast, probability: float) -> bool:
    """Return True if the tolerance is reached within the nights of a warning with this `probability`. The slope of a
    short history must be significant."""
    long = len(trend.series.values) >= SHORT_HISTORY
    return (long or drift.significant) and forecast.within(trend.nights_stated) >= probability


def _line_reaches(trend: Trend, drift: Drift, reach: LimitCrossing) -> bool:
    """Return True if the forecast is missing or ends before the nights of a warning, the slope is significant, and the
    fitted line reaches the tolerance within these nights."""
    unsaid = trend.forecast is None or trend.forecast.horizon < trend.warn_nights
    return unsaid and drift.significant and reach.expected <= trend.warn_nights


def _rate_text(series: Series, drift: Drift) -> str:
    rate, doubt = f"{abs(drift.slope):.2f}", f"{drift.factor * drift.slope_sigma:.2f}"
    if drift.slope * drift.level > 0.0:
        return f"{series.title} grows by {rate} ± {doubt} {series.unit} per night"
    return f"{series.title} changes by {rate} ± {doubt} {series.unit} per night"


def _forecast_text(rate: str, trend: Trend, forecast: LimitForecast) -> str:
    """Return `rate`, the drift in words, and when the tolerance is reached, with the range of dates and the probability
    within the nights for which it is stated. No middle of the range is named beyond the horizon."""
    low, middle, high = trend.days_reached
    tolerance = f"{forecast.limit:g} {trend.series.unit}"
    share, nights = f"{100.0 * forecast.within(trend.nights_stated):.0f}", f"{trend.nights_stated:.3g}"
    if trend.date_reached(0.5) is None:
        return f"{rate}: tolerance {tolerance} may be reached from {low} on (5 %), {share} % within {nights} nights"
    return (
        f"{rate}: tolerance {tolerance} will be reached about {middle} (5 to 95 %: {low} to {high}), {share} % within "
        f"{nights} nights"
    )


def _control_alarm(series: Series, chart: IndividualsChart | None, smoothed: EwmaChart | None) -> Iterable[TrendAlarm]:
    """Yield an alarm only for the newest value, since the alarms for older values were raised before.

    No alarm is raised if a magnitude (a series that is not two-sided) is below the centre line, because that is an
    improvement.
    """
    if chart is None or smoothed is None:
        return
    last = len(smoothed.values) - 1
    value = float(series.values[-1])
    newest = value if last in chart.outside else float(smoothed.values[-1])
    if not series.two_sided and newest < chart.centre:
        return
    if last in chart.outside:
        text = f"{series.title} is {value:.2f} {series.unit}, outside {chart.lower:.2f} to {chart.upper:.2f}"
    elif last in smoothed.outside:
        text = (
            f"the mean of {series.title} has moved to {smoothed.values[-1]:.2f} {series.unit}, outside "
            f"{smoothed.lower[-1]:.2f} to {smoothed.upper[-1]:.2f}"
        )
    else:
        return
    yield TrendAlarm(series.name, AlarmKind.CONTROL, text)


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None
