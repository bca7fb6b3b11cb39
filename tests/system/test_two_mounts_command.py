"""Two mounts with a bar each, by the real commands over the real links: two processes, one CAN bus, nobody asked."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory

import pytest
from stored_run import stored_run

from agent.cli.doctor import examine
from agent.cli.run_commands.simulated_calibration import connect
from agent.cli.run_commands.simulator_process import SimulatorProcess
from agent.planning.job_preparation import prepare_job
from agent.settings.load import load_settings

CONFIG = Path(__file__).resolve().parents[2] / "config"
SETTINGS, SCENARIO = CONFIG / "two-mounts.toml", CONFIG / "simulators" / "two-mounts.toml"


@pytest.fixture
def out() -> Iterator[Path]:
    with TemporaryDirectory() as directory:
        yield Path(directory)


def test_a_whole_run_over_both_stations_without_an_operator(out: Path) -> None:
    command = [sys.executable, "-m", "agent.cli.main", "demo", "--case", "two-mounts", "--json"]
    command += ["--out", str(out / "runs")]
    ended = subprocess.run(command, capture_output=True, text=True, timeout=600.0, check=False)
    document = json.loads(ended.stdout)
    assert (ended.returncode, document["state"], document["reason"]) == (0, "complete", ""), ended.stderr[-2000:]
    assert (document["case"], document["machine"]) == ("two-mounts", "case-study")
    assert document["artefact"] == "ball-bar-1500 + ball-bar-1500-b"
    assert document["verified"] is True
    assert document["collisions"] == 0
    assert document["true_ve_after_um"] < 0.5 * document["true_ve_before_um"]
    assert abs(document["machine_minutes"] / document["predicted_minutes"] - 1.0) < 0.05
    assert kinds_of_steps(out / "runs") == {"asked": 0, "turned": (1, 2)}


def kinds_of_steps(state: Path) -> dict[str, object]:
    """Return the number of questions to the operator, and the stations at which mounts were turned."""
    run = stored_run(state)
    asked = len(run.steps_of("AskOperator"))
    keys = [step.key for step in run.steps_of("OrientTo")]
    stations = {int(part.removeprefix("station-")) for key in keys for part in key.split("/") if "station-" in part}
    return {"asked": asked, "turned": tuple(sorted(stations))}


def test_doctor_looks_at_each_mount(out: Path) -> None:
    with SimulatorProcess(SCENARIO, can="socketcand:127.0.0.1:0", log=out / "simulator.log") as simulator:
        job = prepare_job(connect(load_settings(SETTINGS), simulator.ready, out), SETTINGS.parent)
        findings = examine(job, SETTINGS.parent).findings
    for mount, nodes in (("mount-1", (1, 2)), ("mount-2", (3, 4))):
        lines = findings[mount]
        assert all(line.ok for line in lines)
        assert {line.subject for line in lines} == {
            f"azimuth drive (node {nodes[0]})",
            f"elevation drive (node {nodes[1]})",
        }
