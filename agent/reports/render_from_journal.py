"""Rendering of the report of a run from the journal. The report shows how the main results changed over all runs up to
that run."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from agent.execution.run_record import RunRecord, read_record
from agent.history.figure import trends_svg
from agent.history.journal_runs import runs_until
from agent.history.overview import VOLUMETRIC, trends_of
from agent.history.schema import StoredRun
from agent.history.trends import Trend
from agent.language.sentences import Language
from agent.reports.page.pdf import render_pdf
from agent.reports.page.render import render_report
from agent.reports.run_report import report_of
from agent.settings.history import HistorySettings

MIN_RUNS = 3
_MOST_TRENDS = 4


def render_from_journal(
    directory: Path, run_id: str, *, pdf: bool, language: Language | None = None
) -> dict[str, str | bytes]:
    """Return the files of the report of the run `run_id`: `report.html` and, if `pdf` is set, `report.pdf`.

    `directory` is the state directory with the journal. If `language` is None, it is the one of the settings of the
    run. Raises InputError if there is no such run, or if its record does not suffice for a report.
    """
    record = read_record(directory, run_id)
    data = report_of(record, _trend_figure(directory, record))
    page = render_report(data, language=language or data.document.language)
    files: dict[str, str | bytes] = {"report.html": page}
    if pdf:
        files["report.pdf"] = render_pdf(page)
    return files


def _trend_figure(directory: Path, record: RunRecord) -> str:
    """Return an SVG of the main trends of the machine up to this run; empty if no series has `MIN_RUNS` values."""
    settings = HistorySettings.model_validate(record.settings.get("history", {}))
    shown = _select_trends(runs_until(directory, record, settings), settings)
    return trends_svg(shown) if shown else ""


def _select_trends(runs: Sequence[StoredRun], settings: HistorySettings) -> tuple[Trend, ...]:
    """Return the trends with at least `MIN_RUNS` values: volumetric errors, then others that have a tolerance."""
    trends = [trend for trend in trends_of(runs, settings) if len(trend.series.values) >= MIN_RUNS]
    first = [trend for trend in trends if trend.series.name in VOLUMETRIC]
    held = [trend for trend in trends if trend.series.tolerance is not None and trend not in first]
    return tuple((first + held)[:_MOST_TRENDS])
