"""What another version of volcal stored is refused in one sentence that names file, version and remedy."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner
from journal_surgery import operate
from journaled import SETTINGS, journaled, run_id

from agent.cli.main import main
from agent.errors import JournalFailed
from agent.execution.journal import Journal
from agent.execution.journal_reader import has_journal, open_journal
from agent.execution.journal_schema import FILE_NAME, VERSION, WHOLE_VERSION
from agent.execution.run_record import read_record
from agent.execution.states import RunState
from agent.runs.origin import read_origin
from agent.runs.reference_state import read_reference
from agent.runs.resume.resume import resumable_origin
from agent.runs.unfinished_run import unfinished_run
from agent.service.state.journal_state import JournalState
from drivers.clock import VirtualClock
from drivers.errors import ConfigurationError, InputError

CONFIG = Path(SETTINGS["machine"]).parents[1]
OTHER_ESTIMATE = json.dumps({"format": "volcal estimate 2", "parameters": []})
WORDS = "has the format 'volcal estimate 2', and this version of volcal reads 'volcal estimate 3'"


def test_a_command_refuses_an_estimate_of_another_format(tmp_path: Path) -> None:
    (tmp_path / "other.json").write_text(OTHER_ESTIMATE)
    (tmp_path / "balls.csv").write_text(
        "position,station,azimuth_deg,elevation_deg,tool,ball,x_mm,y_mm,z_mm,sigma_um,temperature_c\n"
        + "".join(f"1,1,0,0,probe,{ball},{1200 + 140 * ball},700,800,1,20\n" for ball in range(11))
    )
    result = CliRunner().invoke(
        main,
        [
            *("identify", str(tmp_path / "balls.csv"), "--machine", str(CONFIG / "machines" / "case-study.toml")),
            *("--artefact", str(CONFIG / "artefacts" / "ball-bar-1500.toml"), "--out", str(tmp_path / "out")),
            *("--carried-over", str(tmp_path / "other.json")),
        ],
    )
    assert result.exit_code == 2, result.output
    said = " ".join(result.output.split())
    assert WORDS in said
    assert "other.json" in said
    assert "balls.csv" in said
    assert not (tmp_path / "out").exists()


def test_a_run_refuses_an_accepted_estimate_of_another_format(tmp_path: Path) -> None:
    journal = Journal(tmp_path)
    run = journal.start_run(run_id(1), "calibrate", {**SETTINGS, "history": {}}, "0.1.0", VirtualClock())
    run.estimate(OTHER_ESTIMATE)
    run.decision("accepted", {"machine": "m", "artefact": "a", "tool": "probe", "crc32": 7, "written": []})
    run.state(RunState.COMPLETE, "", final=True)
    journal.close()
    with pytest.raises(InputError, match=WORDS) as caught:
        read_reference(tmp_path)
    assert run_id(1) in caught.value.where["file"]
    assert "calibrate the machine again" in caught.value.hint


@pytest.mark.parametrize("version", [1, WHOLE_VERSION - 1, VERSION + 1])
def test_a_journal_of_another_version_is_neither_read_nor_changed(tmp_path: Path, version: int) -> None:
    Journal(tmp_path).close()
    operate(tmp_path, f"PRAGMA user_version = {version}")
    before = (tmp_path / FILE_NAME).read_bytes()
    words = (
        f"has version {version}, and this version of volcal reads and writes the versions {WHOLE_VERSION} and {VERSION}"
    )
    for failure in (InputError, JournalFailed):
        with pytest.raises(failure, match=words) as caught, open_journal(tmp_path, failure):
            pass
        assert "move the file" in caught.value.hint
        assert caught.value.where["file"].endswith(FILE_NAME)
    with pytest.raises(ConfigurationError, match=words):
        Journal(tmp_path)
    assert (tmp_path / FILE_NAME).read_bytes() == before


@pytest.mark.parametrize(
    ("changes", "key"),
    [
        ({"gates": {"largest_chi2": 3.0}}, "gates.largest_chi2"),
        ({"mount": {"post_radius_mm": 4.0}}, "mount"),
    ],
)
def test_a_run_with_settings_that_this_version_does_not_know_is_not_resumed(
    tmp_path: Path, changes: dict[str, Any], key: str
) -> None:
    roles = dict.fromkeys(("machine", "probe", "store", "thermometer", "mount", "operator"), "cnc")
    stored = {
        "machine": "machine.toml",
        "artefact": "bar.toml",
        "stations": {"places_mm": [[0.0, 0.0, 0.0]]},
        "roles": roles,
        "devices": {"cnc": {"driver": "linuxcnc"}},
        **changes,
    }
    journal = Journal(tmp_path)
    run = journal.start_run("run-1", "verify", stored, "1.0", VirtualClock())
    start = {"at": "2026-01-01T00:00:00+00:00", "start_mm": [0.0, 0.0, 0.0]}
    run.origin({"kind": "verify", "options": {}, "base": str(tmp_path), "files": {}, **start})
    run.begun()
    journal.close()
    words = "another version of volcal stored the settings of this run"
    with open_journal(tmp_path) as reader, pytest.raises(InputError, match=words) as caught:
        read_origin(reader, 1)
    assert (caught.value.where["run"], caught.value.where["key"]) == ("run-1", key)
    assert "Start a new run" in caught.value.hint


def test_a_journal_without_indexes_gets_them(tmp_path: Path) -> None:
    journaled(tmp_path, 1)
    operate(tmp_path, "DROP INDEX decisions_of_run")
    Journal(tmp_path).close()
    operate(tmp_path, "DROP INDEX decisions_of_run")  # raises an error if there is none
    Journal(tmp_path).close()
    assert read_record(tmp_path, run_id(1)).state == "complete"


def test_a_journal_of_a_newer_version_keeps_its_mode_and_its_log(tmp_path: Path) -> None:
    """As a newer version may have left it: without a write-ahead log, or with one that is not yet merged."""
    Journal(tmp_path).close()
    operate(tmp_path, "PRAGMA journal_mode = DELETE")
    operate(tmp_path, f"PRAGMA user_version = {VERSION + 1}")
    before = (tmp_path / FILE_NAME).read_bytes()
    with pytest.raises(ConfigurationError, match="version"):
        Journal(tmp_path)
    assert (tmp_path / FILE_NAME).read_bytes() == before

    killed = tmp_path / "killed"
    open_one = Journal(killed)
    operate(killed, f"PRAGMA user_version = {VERSION + 1}")
    left = tmp_path / "left"
    shutil.copytree(killed, left)
    open_one.close()
    log = left / f"{FILE_NAME}-wal"
    before = log.read_bytes()
    assert before
    with pytest.raises(ConfigurationError, match="version"):
        Journal(left)
    assert log.read_bytes() == before


def test_an_empty_file_is_no_journal_yet(tmp_path: Path) -> None:
    """As a full disk or a power cut leaves it."""
    (tmp_path / FILE_NAME).touch()
    for _ in range(2):  # the second time with the header of a database, but without tables
        assert not has_journal(tmp_path)
        assert unfinished_run(tmp_path) is None
        assert JournalState(tmp_path).unacknowledged_end() is None
        with pytest.raises(InputError, match="no run yet"), open_journal(tmp_path):
            pass
        with pytest.raises(InputError, match="no run to resume"):
            resumable_origin(tmp_path)
        operate(tmp_path, "PRAGMA journal_mode = WAL")
    assert (tmp_path / FILE_NAME).stat().st_size > 0
    journal = Journal(tmp_path)
    journal.start_run(run_id(1), "calibrate", SETTINGS, "0.1.0", VirtualClock())
    journal.close()
    assert has_journal(tmp_path)
