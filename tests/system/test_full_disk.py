"""`volcal calibrate` on a disk that becomes full: the first cause is told, with the exit code of a faulted run."""

from __future__ import annotations

import json
import subprocess
from pathlib import Path

import pytest
from aloud import NOT_HERE
from namespaces import on_small_disk, small_disk_missing
from service_process import short_settings, simulator
from simulated import COMMAND, PATIENCE_S


@pytest.mark.parametrize(
    ("size", "place"), [("200k", ""), ("900k", " (step ")], ids=["before-the-motion", "while-measuring"]
)
def test_a_full_disk_is_a_faulted_run_with_its_first_cause(tmp_path: Path, size: str, place: str) -> None:
    state = tmp_path / "state"
    state.mkdir()
    if absent := small_disk_missing(state):
        pytest.skip(f"{NOT_HERE}: a run on a disk that becomes full: {absent}")
    with simulator(tmp_path) as (_, ready):
        config = short_settings(ready, tmp_path)
        command = [*COMMAND, "calibrate", "--config", str(config), "--json"]
        ended = subprocess.run(
            on_small_disk(state, size, command), capture_output=True, text=True, timeout=PATIENCE_S, check=False
        )
    assert ended.returncode == 4, ended.stderr
    assert json.loads(ended.stdout)["state"] == "faulted"
    assert "Traceback" not in ended.stderr
    (complaint,) = [line for line in ended.stderr.splitlines() if line.startswith("error:")]
    assert complaint.startswith(f"error: the journal cannot be written: no space left on the disk{place}")
