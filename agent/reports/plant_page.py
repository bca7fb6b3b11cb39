"""Page with one row for each machine of a plant, as one self-contained HTML file."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import datetime
from importlib import resources

from markupsafe import Markup

from agent.history.plant import MachineSummary
from agent.html_templates import html_template
from agent.language.sentences import Language, as_it_is
from agent.reports.page.german import page_in_language
from agent.reports.run_report import TITLES

SPARK_WIDTH, SPARK_HEIGHT = 120.0, 24.0


def plant_html(machines: Sequence[MachineSummary], database: str, now: datetime, language: Language = "en") -> str:
    """Return the page. `database` is the address of the history without its password, `now` the time of the reading."""
    return page_in_language(_english(machines, database, now), language)


def _english(machines: Sequence[MachineSummary], database: str, now: datetime) -> str:
    style = resources.files("agent.reports.page").joinpath("report.css").read_text(encoding="utf-8")
    return html_template("agent.reports", "plant.html").render(
        css=Markup(style),  # noqa: S704  a file of this package
        rows=[
            (as_it_is(one.machine), one, TITLES.get(one.last.kind, one.last.kind), drift_text(one), spark_points(one))
            for one in machines
        ],
        database=as_it_is(database),
        date=f"{now:%Y-%m-%d %H:%M} UTC",
        width=SPARK_WIDTH,
        height=SPARK_HEIGHT,
    )


def drift_text(machine: MachineSummary) -> str:
    """Return the drift of the VE without a table in µm per night; no rate is stated if none can be told from zero."""
    found = machine.drift_um
    if found is None:
        return "too few nights"
    drift, doubt = found
    return f"{drift:+.3f} ± {doubt:.3f}" if machine.drifts else f"none (± {doubt:.3f})"


def spark_points(machine: MachineSummary) -> str:
    """Return the points of a small line of the VE without a table over the days, from zero upwards; empty for fewer
    than two values."""
    if machine.trend is None or len(machine.trend.series.values) < 2:
        return ""
    days, values = machine.trend.series.nights, machine.trend.series.values
    span, top = float(days[-1] - days[0]) or 1.0, float(values.max()) or 1.0
    points = (
        f"{SPARK_WIDTH * (day - days[0]) / span:.1f},{SPARK_HEIGHT * (1.0 - 0.95 * value / top):.1f}"
        for day, value in zip(days.tolist(), values.tolist(), strict=True)
    )
    return " ".join(points)
