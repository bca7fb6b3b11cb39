"""Figure of the trends of a machine's results. It shows values, uncertainties, fitted lines with uncertainty bands,
sudden changes (steps), control limits, tolerances, and when these are reached.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, MaxNLocator

from agent.figures.style import (
    BAND_OPACITY,
    BLUE,
    INK,
    ORANGE,
    PURPLE,
    QUIET,
    REPORT_WIDTH_IN,
    Drawing,
    Margins,
    Picture,
    picture,
)
from agent.history.trends import Trend
from twin.monitoring import Drift
from twin.monitoring.limit_forecast import HIGH, LOW, LimitForecast

COVERAGE = 2.0
_COLUMNS = 2
_ROW_IN = 2.2
_ABOVE = 1.08  # room above the tolerance
_BEYOND = 1.1  # of the last date that is marked


def draw_trends(trends: Sequence[Trend]) -> Picture:
    """Return a figure with one panel per trend and two panels in each row."""
    rows = -(-len(trends) // _COLUMNS)
    size = (9.0, max(_ROW_IN * rows, 2.6) + 0.4)
    return picture("trends", lambda figure: _panels(figure, trends, QUIET), size)


def trends_svg(trends: Sequence[Trend]) -> str:
    """Return an SVG image for a report with one panel per trend and two panels in each row.

    The colours of the figure follow the theme of the report page.
    """
    rows = -(-len(trends) // _COLUMNS)
    drawing = Drawing("trends", REPORT_WIDTH_IN, 2.1 * rows + 0.3, Margins(bottom=0.45))
    with drawing as figure:
        figure.subplots_adjust(wspace=0.2, hspace=0.75)
        _panels(figure, trends, INK)
    return drawing.svg()


def _panels(figure: Figure, trends: Sequence[Trend], quiet: str) -> None:
    rows = -(-len(trends) // _COLUMNS)
    columns = min(len(trends), _COLUMNS)
    panels = np.atleast_1d(figure.subplots(rows, columns)).ravel()
    for panel, trend in zip(panels, trends, strict=False):
        _panel(panel, trend, quiet)
    for panel in panels[len(trends) :]:
        panel.set_axis_off()


def _panel(panel: Axes, trend: Trend, quiet: str) -> None:
    series, drift = trend.series, trend.drift
    panel.set_title(series.title, loc="left")
    doubt = COVERAGE * series.sigmas if series.stated else None
    panel.errorbar(series.nights, series.values, yerr=doubt, fmt="o", color=BLUE, markersize=3.5, elinewidth=0.7)
    if drift is not None:
        _line(panel, trend, drift, quiet)
    if trend.chart is not None:
        for limit in (trend.chart.lower, trend.chart.upper):
            panel.axhline(limit, color=quiet, linewidth=0.8, linestyle=":")
    if series.tolerance is not None:
        for side in (1.0, -1.0) if series.two_sided else (1.0,):
            panel.axhline(side * series.tolerance, color=PURPLE, linewidth=1.0, linestyle="--")
    if not series.two_sided:
        panel.set_ylim(bottom=0.0)
    if trend.forecast is not None:
        _ahead(panel, trend, trend.forecast)
    panel.set_ylabel(series.unit)
    panel.xaxis.set_major_locator(MaxNLocator(nbins=4))
    panel.xaxis.set_major_formatter(FuncFormatter(lambda night, _: f"{series.date(night):%Y-%m-%d}"))


def _line(panel: Axes, trend: Trend, drift: Drift, quiet: str) -> None:
    """Draw the fitted line in sections from step to step, so that no slanted line connects the two sides of a step.

    The uncertainty band is drawn only for the last section. Without a significant slope only the steps are drawn.
    """
    nights = trend.series.nights
    for at, _, _ in drift.steps:
        panel.axvline(at, color=quiet, linewidth=0.7, linestyle="-.")
    if not drift.significant:
        return
    edges = [-np.inf, *(at for at, _, _ in drift.steps), np.inf]
    for start, end in pairwise(edges):
        chosen = (nights >= start) & (nights < end)
        panel.plot(nights[chosen], drift.fitted[chosen], color=ORANGE, linewidth=1.2)
    recent = nights[nights >= edges[-2]]
    ahead = [drift.predict(night - nights[-1]) for night in recent]
    value, sigma = np.array(ahead).T
    half = drift.factor * sigma
    panel.fill_between(recent, value - half, value + half, color=ORANGE, alpha=BAND_OPACITY, linewidth=0)


def _ahead(panel: Axes, trend: Trend, forecast: LimitForecast) -> None:
    """Draw the expected value of the next nights with the band from 5 % to 95 %, and the dates at which the tolerance
    is reached with 5 %, 50 % and 95 % as marks on it.

    Nothing is drawn if no date is expected: the nights that were measured then have the whole width.
    """
    expected, last = forecast.nights_to(0.5), float(trend.series.nights[-1])
    if expected is None:
        return
    low, high = panel.get_ylim()  # a wide band would press the values together
    panel.set_ylim(low, max(high, _ABOVE * forecast.limit))
    end = min(forecast.horizon, _BEYOND * (forecast.nights_to(HIGH) or forecast.horizon))
    shown = forecast.nights <= end
    nights = last + forecast.nights[shown]
    panel.plot(nights, forecast.middle[shown], color=ORANGE, linewidth=1.2, linestyle="--")
    panel.fill_between(nights, forecast.low[shown], forecast.high[shown], color=ORANGE, alpha=0.5 * BAND_OPACITY, lw=0)
    side = np.sign(np.interp(expected, forecast.nights, forecast.middle)) if trend.series.two_sided else 1.0
    for probability, mark in ((LOW, "|"), (0.5, "o"), (HIGH, "|")):
        ahead = forecast.nights_to(probability)
        if ahead is not None:
            panel.plot(last + ahead, side * forecast.limit, mark, color=PURPLE, markersize=6 if mark == "o" else 11)
