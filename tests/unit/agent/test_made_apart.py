"""What the service leaves to other processes."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from agent.execution.journal import Journal
from agent.reporting.apart import rebuilt_apart
from agent.service.reports import Reports
from drivers.errors import InputError

WANTED_LATER = ("matplotlib", "sqlalchemy", "weasyprint", "dask", "scipy.stats", "asyncua", "jinja2")


def test_the_service_starts_without_what_draws_or_speaks_to_databases() -> None:
    program = f"import sys, agent.service.serving; print([m for m in {WANTED_LATER} if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=50, check=True)
    assert done.stdout.strip() == "[]"


def test_a_report_that_cannot_be_made_is_said_in_one_line(tmp_path: Path) -> None:
    Journal(tmp_path).close()
    with pytest.raises(InputError, match="nobody") as said:
        rebuilt_apart(tmp_path, "nobody", pdf=False)
    assert "Traceback" not in str(said.value)
    assert "\n" not in str(said.value)


def test_a_report_is_made_once_and_again_when_the_run_has_gone_on(tmp_path: Path) -> None:
    made: list[str] = []

    def make(_: Path, run_id: str) -> dict[str, str | bytes]:
        made.append(run_id)
        return {"report.html": f"version {len(made)}"}

    reports = Reports(tmp_path, make)
    assert reports.path("a").read_text() == "version 1"
    assert reports.path("a").read_text() == "version 1"
    reports.wanted("a")
    assert reports.path("a").read_text() == "version 2"
    assert reports.path("a").read_text() == "version 2"
    assert made == ["a", "a"]
