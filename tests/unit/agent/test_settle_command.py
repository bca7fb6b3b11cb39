"""`volcal resume --restore` and `--give-up` on a controller that refuses the former table: what they print."""

from __future__ import annotations

from pathlib import Path

import pytest
from click.testing import CliRunner

from agent.cli.main import main
from agent.cli.run_commands import resume
from agent.runs.reconcile_result import CompensationState, ReconcileAction, Reconciliation
from agent.runs.unproved_table import UnprovedTable

TABLE = UnprovedTable("20261128T010000Z-abcd", 2, 1, provable=True)


def left(table: UnprovedTable) -> Reconciliation:
    return Reconciliation(
        CompensationState.UNPROVED, ReconcileAction.LEFT, 2, None, None, table.way_out, table, "bank locked"
    )


@pytest.fixture
def config(tmp_path: Path) -> Path:
    path = tmp_path / "volcal.toml"
    shipped = Path(__file__).parents[3] / "config" / "machines" / "case-study.toml"
    artefact = shipped.parents[1] / "artefacts" / "ball-bar-1500.toml"
    path.write_text(
        f'machine = "{shipped}"\nartefact = "{artefact}"\nstate_directory = "{tmp_path / "state"}"\n'
        '[devices.twin]\ndriver = "simulated"\n'
        f'options = {{ scenario = "{shipped.parents[1] / "simulators" / "case-study.toml"}" }}\n'
        '[roles]\nmachine = "twin"\nprobe = "twin"\nstore = "twin"\nthermometer = "twin"\nmount = "twin"\n'
        'operator = "twin"\n[stations]\nplaces_mm = [[700.0, 1000.0, 750.0]]\nstanding_at = 1\n'
    )
    return path


def said(config: Path, option: str) -> tuple[int, str]:
    result = CliRunner().invoke(main, ["resume", option, "--config", str(config)])
    return result.exit_code, " ".join(result.output.split())


def test_a_refused_restore_names_table_reason_and_the_ways_out_once(
    config: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(resume, "reconcile", lambda *_: left(TABLE))
    code, text = said(config, "--restore")
    assert code == 3
    assert f"{TABLE.situation}: bank locked" in text
    assert text.count("`volcal resume --restore`") == 1
    assert "which proves the table by fresh measurements" in text


def test_a_refused_last_restore_says_what_is_active_and_what_to_do(
    config: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    ended = UnprovedTable(TABLE.run_id, 2, 0, provable=False)
    monkeypatch.setattr(resume, "abandon_run", lambda *_: left(ended))
    code, text = said(config, "--give-up")
    assert code == 3
    assert f"the run has ended, but {ended.situation}: bank locked" in text
    assert "switch the compensation off at the controller (bank 0)" in text
    assert "until then no run starts" in text


def test_both_ways_at_once_are_refused(config: Path) -> None:
    result = CliRunner().invoke(main, ["resume", "--restore", "--give-up", "--config", str(config)])
    assert result.exit_code == 2
    assert "exclude each other" in result.output
