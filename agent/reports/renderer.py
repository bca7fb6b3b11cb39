"""Interface of functions that render the files of a report."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path

ReportRenderer = Callable[[Path, str], Mapping[str, str | bytes]]
"""State directory and identity of the run → name and content of its files."""


def render_in_process(directory: Path, run_id: str) -> Mapping[str, str | bytes]:
    """Return the HTML report, rendered in this process, which keeps the drawing libraries loaded afterwards."""
    from agent.reports.render_from_journal import render_from_journal  # noqa: PLC0415  drawing libraries are loaded only when needed

    return render_from_journal(directory, run_id, pdf=False)
