"""Work that the service hands to other processes."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from threading import Event

import pytest

from agent.execution.journal import Journal
from agent.reports.render_in_subprocess import render_in_subprocess
from agent.service.state.reports import ReportQueue
from drivers.errors import InputError

PATIENCE_S = 600.0
WANTED_LATER = ("matplotlib", "sqlalchemy", "weasyprint", "dask", "scipy.stats", "asyncua", "jinja2")


def test_the_service_starts_without_what_draws_or_speaks_to_databases() -> None:
    program = f"import sys, agent.service.daemon.serve; print([m for m in {WANTED_LATER} if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=600.0, check=True)
    assert done.stdout.strip() == "[]"


def test_a_report_that_cannot_be_made_is_said_in_one_line(tmp_path: Path) -> None:
    Journal(tmp_path).close()
    with pytest.raises(InputError, match="nobody") as said:
        render_in_subprocess(tmp_path, "nobody", pdf=False)
    assert "Traceback" not in str(said.value)
    assert "\n" not in str(said.value)


def test_a_report_is_made_once_and_again_when_the_run_has_gone_on(tmp_path: Path) -> None:
    made: list[str] = []

    def make(_: Path, run_id: str) -> dict[str, str | bytes]:
        made.append(run_id)
        return {"report.html": f"version {len(made)}"}

    reports = ReportQueue(tmp_path, make)
    assert reports.path("a").read_text() == "version 1"
    assert reports.path("a").read_text() == "version 1"
    reports.request("a")
    assert reports.path("a").read_text() == "version 2"
    assert reports.path("a").read_text() == "version 2"
    assert made == ["a", "a"]


def test_who_closes_waits_for_the_report_being_made_and_begins_no_more(tmp_path: Path) -> None:
    begun, go_on, made = Event(), Event(), []

    def make(_: Path, run_id: str) -> dict[str, str | bytes]:
        begun.set()
        assert go_on.wait(PATIENCE_S)
        made.append(run_id)
        return {"report.html": run_id}

    reports = ReportQueue(tmp_path, make)
    reports.request("a")
    assert begun.wait(PATIENCE_S)
    reports.request("b")
    assert not reports.close(0.0)
    go_on.set()
    assert reports.close(PATIENCE_S)
    reports.request("c")
    assert made == ["a"]
    assert (tmp_path / "a" / "report.html").read_text() == "a"
    assert reports.path("c").read_text() == "c"


def test_a_run_that_has_gone_on_leaves_no_old_report_to_who_comes_after(tmp_path: Path) -> None:
    reports = ReportQueue(tmp_path, lambda *_: {"report.html": "old"})
    reports.path("a")
    reports.close(PATIENCE_S)
    reports.request("a")
    assert ReportQueue(tmp_path, lambda *_: {"report.html": "new"}).path("a").read_text() == "new"


def test_a_run_that_ends_again_while_its_report_is_drawn_gets_another(tmp_path: Path) -> None:
    reports: ReportQueue

    def make(_: Path, run_id: str) -> dict[str, str | bytes]:
        made.append(run_id)
        if len(made) == 1:
            reports.request(run_id)
        return {"report.html": f"version {len(made)}"}

    made: list[str] = []
    reports = ReportQueue(tmp_path, make)
    reports.close(PATIENCE_S)
    assert reports.path("a").read_text() == "version 1"
    assert reports.path("a").read_text() == "version 2"
