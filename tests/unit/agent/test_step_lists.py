"""Steps as CSV: those of every branch of a plan, and those that a run has carried out."""

from __future__ import annotations

import csv
from pathlib import Path

import pytest
from click.testing import CliRunner
from journaled import SETTINGS
from volcal_command import volcal

from agent.cli.main import main
from agent.execution.engine import Engine
from agent.execution.journal import Journal
from agent.execution.steps import Dwell, MoveTo, Plan, Record
from drivers.clock import VirtualClock

CASE_STUDY = Path(__file__).resolve().parents[3] / "config" / "case-study.toml"
SHORT = ("plan", "--config", str(CASE_STUDY), "--position-set", "S1", "--stations", "2")


def rows(file: Path) -> list[dict[str, str]]:
    with file.open(encoding="utf-8", newline="") as text:
        return list(csv.DictReader(text))


@pytest.fixture(scope="module")
def walked(tmp_path_factory: pytest.TempPathFactory) -> list[dict[str, str]]:
    file = tmp_path_factory.mktemp("steps") / "plan.csv"
    done = CliRunner().invoke(main, [*SHORT, "--steps", str(file)])
    assert done.exit_code in (0, 7), done.output  # 7: a gate is expected to refuse so small a set
    return rows(file)


def test_every_branch_has_its_steps_with_rising_minutes(walked: list[dict[str, str]]) -> None:
    assert list(walked[0]) == ["branch", "key", "minutes"]
    names = dict.fromkeys(row["branch"] for row in walked)
    for end in ("table written, accepted", "table written, former table restored", "table confirmed", "refused"):
        assert f"measured once, {end}" in names
    assert any("withdrawn from measure/station-2/" in name for name in names)
    for name in names:
        minutes = [float(row["minutes"]) for row in walked if row["branch"] == name and row["minutes"]]
        assert minutes == sorted(minutes)
        assert minutes[-1] > 0.0


def test_the_ends_of_a_run_differ_in_what_is_written(walked: list[dict[str, str]]) -> None:
    def keys(name: str) -> list[str]:
        return [row["key"] for row in walked if row["branch"] == name]

    accepted, restored, kept = (
        keys(f"measured once, {end}")
        for end in ("table written, accepted", "table written, former table restored", "table confirmed")
    )
    assert restored[: len(accepted)] == accepted
    assert restored[len(accepted) :] == ["restore/activate", "restore/active-bank", "restore/active-table"]
    assert kept == accepted[: len(kept)]
    assert accepted[len(kept)] == "publish/stage"


def test_the_steps_of_a_run_are_those_of_its_procedure(tmp_path: Path) -> None:
    clock = VirtualClock()
    journal = Journal(tmp_path / "state")
    run = journal.start_run("20261101T020000Z-0000", "calibrate", SETTINGS, "1.2.3", clock)

    def carried_out(prefix: str) -> Plan[None]:
        yield MoveTo(f"{prefix}/move", (0.0, 0.0, 0.0))
        yield Record(f"{prefix}/seen", "event", {})
        yield Dwell(f"{prefix}/wait", 90.0)

    actions = {MoveTo: lambda _: None, Record: lambda _: None, Dwell: lambda step: clock.sleep(step.duration_s)}
    engine = Engine(actions, run)
    engine.run(carried_out("measure"))
    engine.aside().run(carried_out("recover"))
    journal.close()
    config = tmp_path / "volcal.toml"
    config.write_text(CASE_STUDY.read_text().replace('"../runs"', f'"{tmp_path / "state"}"'))
    file = tmp_path / "run.csv"
    volcal("report", "last", "--config", config, "--steps", file)
    assert rows(file) == [{"key": "measure/move", "minutes": "0.0000"}, {"key": "measure/wait", "minutes": "1.5000"}]


def test_a_file_that_cannot_be_written_is_an_error_of_the_user(tmp_path: Path) -> None:
    (tmp_path / "taken").write_text("")
    done = volcal(*SHORT, "--steps", tmp_path / "taken" / "plan.csv", exit_code=2)
    assert "error: " in done.output
