"""The files of a report out of the journal, with the trend of the runs up to that one."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from agent.execution.run_record import RunRecord, read_record, run_ids
from agent.history.figure import trends_svg
from agent.history.overview import VOLUMETRIC, trends_of
from agent.history.run_row import run_rows
from agent.history.schema import StoredRun
from agent.history.store import stored_run
from agent.history.trends import Trend
from agent.reports.page.pdf import render_pdf
from agent.reports.page.render import render_report
from agent.reports.run_report import report_of
from agent.settings.history import HistorySettings

MIN_RUNS = 3
_MOST_TRENDS = 4


def render_from_journal(directory: Path, run_id: str, *, pdf: bool) -> dict[str, str | bytes]:
    """`report.html`, and `report.pdf` where wanted, of a run of the journal in the state directory. InputError where
    there is no such run, or where it does not hold what a report needs."""
    record = read_record(directory, run_id)
    page = render_report(report_of(record, _trend_figure(directory, record)))
    files: dict[str, str | bytes] = {"report.html": page}
    if pdf:
        files["report.pdf"] = render_pdf(page)
    return files


def _trend_figure(directory: Path, record: RunRecord) -> str:
    """SVG of the foremost trends of this machine up to the run, by this journal; empty below `MIN_RUNS` values."""
    known = run_ids(directory)
    earlier = [read_record(directory, run_id) for run_id in known[: known.index(record.run_id) + 1]]
    fed = [run_rows(one) for one in earlier]
    machine = fed[-1].run["machine"]
    runs = [stored_run(one) for one in fed if one.run["machine"] == machine]
    shown = _select_trends(runs, HistorySettings.model_validate(record.settings.get("history", {})))
    return trends_svg(shown) if shown else ""


def _select_trends(runs: Sequence[StoredRun], settings: HistorySettings) -> tuple[Trend, ...]:
    """Volumetric errors, then what has a tolerance, as far as there are nights enough for a line."""
    trends = [trend for trend in trends_of(runs, settings) if len(trend.series.values) >= MIN_RUNS]
    first = [trend for trend in trends if trend.series.name in VOLUMETRIC]
    held = [trend for trend in trends if trend.series.tolerance is not None and trend not in first]
    return tuple((first + held)[:_MOST_TRENDS])
