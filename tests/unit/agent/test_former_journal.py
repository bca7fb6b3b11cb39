"""Journals and commands with an estimate of an earlier version, whose lever arms began at the zeros of the axes."""

from __future__ import annotations

from collections import deque
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner
from former_estimate import PARAMETERS, TEXT, assert_field, changed, stored, two_tools
from journaled import SETTINGS, dated, run_id

from agent.cli.main import main
from agent.errors import PlanDiverged
from agent.execution.journal import Journal
from agent.execution.replay_log import ReplayLog, comparable_estimate
from agent.execution.run_record import read_record
from agent.execution.states import RunState
from agent.history.run_row import run_rows
from agent.runs.reference_state import read_reference
from drivers.clock import VirtualClock
from drivers.errors import InputError


def test_command_refuses_it_as_prior(tmp_path: Path) -> None:
    config = Path(SETTINGS["machine"]).parents[1]
    (tmp_path / "former.json").write_text(two_tools())
    (tmp_path / "balls.csv").write_text(
        "position,station,azimuth_deg,elevation_deg,tool,ball,x_mm,y_mm,z_mm,sigma_um,temperature_c\n"
        + "".join(f"1,1,0,0,probe,{ball},{1200 + 140 * ball},700,800,1,20\n" for ball in range(11))
    )
    result = CliRunner().invoke(
        main,
        [
            *("identify", str(tmp_path / "balls.csv"), "--machine", str(config / "machines" / "case-study.toml")),
            *("--artefact", str(config / "artefacts" / "ball-bar-1500.toml"), "--out", str(tmp_path / "out")),
            *("--carried-over", str(tmp_path / "former.json")),
        ],
    )
    assert result.exit_code == 2, result.output
    assert "2 tools cannot be converted" in " ".join(result.output.split())
    assert not (tmp_path / "out").exists()


def journaled(state: Path, text: str, written: np.ndarray) -> None:
    """Write a calibration of an earlier version into a journal, with `written` as the parameters of the table."""
    journal = Journal(state)
    try:
        run = journal.start_run(run_id(1), "calibrate", {**SETTINGS, "history": {}}, "0.1.0", VirtualClock())
        run.estimate(text)
        accepted: dict[str, Any] = {"machine": "m", "artefact": "a", "tool": "probe", "crc32": 7}
        run.decision("accepted", {**accepted, "written": written.tolist()})
        run.state(RunState.COMPLETE, "", final=True)
    finally:
        journal.close()
    dated(state, 1)


def test_journal_of_the_former_version(tmp_path: Path) -> None:
    """The table that is active is described by parameters too, and the history shows the present ones."""
    journaled(tmp_path, TEXT, PARAMETERS)
    reference = read_reference(tmp_path)
    assert reference is not None
    assert_field(reference.estimate.model, reference.table.written, "estimate")
    rows = run_rows(read_record(tmp_path, run_id(1))).parameters
    names = {row["name"]: row for row in rows}
    known = stored()
    index = known.model.index("A0Z")
    assert names["A0Z"]["value"] == pytest.approx(1e6 * known.parameters[index])
    assert names["A0Z"]["standard_uncertainty"] == pytest.approx(1e6 * np.sqrt(known.covariance[index, index]))


def test_journal_that_cannot_be_converted(tmp_path: Path) -> None:
    journaled(tmp_path, two_tools(), np.zeros(stored().model.size))
    with pytest.raises(InputError, match="2 tools cannot be converted") as caught:
        read_reference(tmp_path)
    assert run_id(1) in caught.value.where["file"]
    assert run_rows(read_record(tmp_path, run_id(1))).parameters == ()


def test_run_of_the_former_version_is_not_resumed_after_its_estimate() -> None:
    log = ReplayLog(entries={"estimates": deque([comparable_estimate(TEXT)])})
    with pytest.raises(PlanDiverged, match="'volcal estimate 2' where the run now comes to 'volcal estimate 3'"):
        log.consume("estimates", *comparable_estimate(changed(format="volcal estimate 3")))
