"""Interface of the functions that render the files of a report, and the function that is used by default."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path

ReportRenderer = Callable[[Path, str], Mapping[str, str | bytes]]
"""Function that maps a state directory and the identity of a run to the files of the report, name → content."""


def render_in_process(directory: Path, run_id: str) -> Mapping[str, str | bytes]:
    """Return the HTML report of a run, rendered in this process. The drawing libraries remain loaded afterwards."""
    from agent.reports.render_from_journal import render_from_journal  # noqa: PLC0415  drawing libraries are loaded only when needed

    return render_from_journal(directory, run_id, pdf=False)
