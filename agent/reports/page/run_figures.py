"""Figures of a run on a machine: the temperatures over time, and the residuals at the held-out positions before and
after activation of the new compensation table."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.ticker import MaxNLocator

from agent.figures.style import BLUE, GREEN, INK, ORANGE, PURPLE, REPORT_WIDTH_IN, Drawing, Margins
from agent.reports.page.data import TemperatureTrace, VerifiedPosition

MAX_UPRIGHT = 8
SENSOR_COLOURS = (BLUE, ORANGE, GREEN, PURPLE)
SENSOR_LINES = ("-", "--", "-.", ":")


def draw_temperatures(traces: Sequence[TemperatureTrace], drifts_um: Sequence[float] = ()) -> str:
    """Return an SVG of the temperatures over time. If `drifts_um` is not empty, the SVG also shows the displacement of
    the first ball of each position between its two measurements."""
    drawing = Drawing("temperatures", REPORT_WIDTH_IN, 2.2)
    with drawing as figure:
        if len(drifts_um):
            panel, beside = figure.subplots(1, 2, gridspec_kw={"width_ratios": [3, 2]})
            beside.bar(np.arange(1, len(drifts_um) + 1), drifts_um, color=BLUE, width=0.7)
            beside.set_xlabel("position, in the order measured")
            beside.set_ylabel("displacement of first ball / µm")
            beside.xaxis.set_major_locator(MaxNLocator(integer=True))
        else:
            panel = figure.subplots()
        for count, trace in enumerate(traces):
            colour, line = sensor_look(count)
            panel.plot(trace.minutes, trace.temperature_c, line, color=colour, label=trace.name)
        panel.set_xlabel("minutes since the start")
        panel.set_ylabel("temperature / °C")
        panel.legend(ncols=4, loc="lower right", bbox_to_anchor=(1.0, 1.0), borderaxespad=0.1)
    return drawing.svg()


def sensor_look(count: int) -> tuple[str, str]:
    """Return the colour and the style of the line of sensor number `count`, from 0. The first 16 sensors differ."""
    rounds, place = divmod(count, len(SENSOR_COLOURS))
    return SENSOR_COLOURS[place], SENSOR_LINES[(place + rounds) % len(SENSOR_LINES)]


def draw_position_temperatures(position: np.ndarray, temperature_c: np.ndarray) -> str:
    """Return an SVG of the artefact's temperature at each ball, for measurements that have no time stamps."""
    drawing = Drawing("temperatures", REPORT_WIDTH_IN, 1.9)
    with drawing as figure:
        panel = figure.subplots()
        panel.plot(position, temperature_c, "o", color=BLUE, markersize=2.6, markeredgewidth=0)
        panel.set_xlabel("position, counted from 0")
        panel.set_ylabel("artefact / °C")
        panel.xaxis.set_major_locator(MaxNLocator(integer=True))
        panel.ticklabel_format(axis="y", useOffset=False)
    return drawing.svg()


def draw_verification(positions: Sequence[VerifiedPosition]) -> str:
    """Return an SVG with three values for each held-out position: the rms residual before and after activation of the
    new compensation table, and twice the predicted rms residual."""
    drawing = Drawing("verification", REPORT_WIDTH_IN, 2.6, Margins(bottom=0.72, left=0.7))
    with drawing as figure:
        panel = figure.subplots()
        place = np.arange(len(positions), dtype=float)
        bare = [(x, item.before_um) for x, item in zip(place, positions, strict=True) if item.before_um is not None]
        if bare:
            panel.plot(*zip(*bare, strict=True), "s", color=ORANGE, markersize=5, label="before")
        panel.plot(place, [item.after_um for item in positions], "o", color=BLUE, markersize=5, label="after")
        limits = [2.0 * item.predicted_um for item in positions]
        panel.plot(place, limits, "_", color=INK, markersize=14, label="limit")
        many = len(positions) > MAX_UPRIGHT
        labels = [item.label if many else item.label.replace(", ", "\n", 1) for item in positions]
        panel.set_xticks(place, labels, rotation=25 if many else 0, ha="right" if many else "center")
        panel.set_xlim(-0.5, len(positions) - 0.5)
        panel.set_ylim(bottom=0.0)
        panel.set_ylabel("rms at the balls / µm")
        panel.legend(ncols=3, loc="lower right", bbox_to_anchor=(1.0, 1.0), borderaxespad=0.1)
        panel.grid(visible=False, axis="x")
    return drawing.svg()
