"""`volcal calibrate` killed with SIGKILL over real links, and `volcal resume` in another process."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any

from simulated import SHORT_SET, balls_in, configured, scenario_text, simulated, wait_until
from stored_run import stored_run

BALLS_BEFORE_THE_KILL = 5


def short_case(directory: Path) -> tuple[Path, str]:
    """A scenario whose noise belongs to the steps, and what makes the shipped settings a short run on it."""
    text = scenario_text().replace("seed = 1 ", "noise_by_step = true\nseed = 1 ")
    assert tomllib.loads(text)["noise_by_step"] is True
    path = directory / "scenario.toml"
    path.write_text(text.replace("[truth]", "[truth]\nscale = 6.0"))
    (directory / "positions.csv").write_text(SHORT_SET)
    return path, str(directory / "positions.csv")


def shortened(config: Path, positions: str) -> Path:
    """The settings with three positions, one held out, and gates so wide that the table is written and proved."""
    text = config.read_text()
    for former, now in (
        ('position_set = "S3"', f'position_set = "{positions}"\nstations = [1]'),
        (
            "[verification]\nstations = [1, 4]",
            "[verification]\nstations = [1]\npositions_deg = [[20.0, 25.0]]\nmax_chi2 = 1e3",
        ),
        (
            "[timing]",
            "[gates]\nmin_degrees_of_freedom = 1\nmax_unmeasured_fraction = 10.0\nmax_chi2 = 1e3\n\n[timing]",
        ),
    ):
        assert former in text, former
        text = text.replace(former, now)
    config.write_text(f"{text}\n[table]\nstep_mm = [500.0, 325.0, 500.0]\n")
    return config


def volcal(directory: Path, *arguments: str) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, "-m", "agent.cli.main", *arguments, "--json"],
        cwd=directory,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def kill_calibration(directory: Path, config: Path, reached: Callable[[], bool]) -> None:
    """Start a calibration in a process of its own, and kill it once `reached` is True."""
    with volcal(directory, "calibrate", "--config", str(config)) as agent:
        try:
            wait_until(reached, agent)
            os.kill(agent.pid, signal.SIGKILL)
            agent.communicate(timeout=600.0)
        finally:
            agent.kill()


def finished(agent: subprocess.Popen[str]) -> dict[str, Any]:
    try:
        stdout, stderr = agent.communicate(timeout=600.0)
    finally:
        agent.kill()
    assert agent.returncode == 0, stderr
    document: dict[str, Any] = json.loads(stdout)
    return document


def test_a_killed_calibration_goes_on_to_its_end(tmp_path: Path) -> None:
    scenario, positions = short_case(tmp_path)
    with simulated(scenario) as (_, ready):
        config = shortened(configured(ready, tmp_path), positions)
        state = tmp_path / "state"
        kill_calibration(tmp_path, config, lambda: balls_in(state) >= BALLS_BEFORE_THE_KILL)
        killed = stored_run(state)
        assert (killed.row.state, killed.row.ended) == ("measuring", None)
        outcome = finished(volcal(tmp_path, "resume", "--config", str(config)))
    assert outcome["state"] == "complete"
    run = stored_run(state)
    assert outcome["touches"] == len(run.touches)
    assert run.balls[: len(killed.balls)] == killed.balls
    assert run.measured_twice == []
    assert any(step.key.startswith("resume-1/datum/") for step in run.steps)
    assert (run.row.state, run.row.ended is not None) == ("complete", True)


def test_a_run_killed_during_its_proof_is_restored_by_command_and_can_still_prove_its_table(tmp_path: Path) -> None:
    scenario, positions = short_case(tmp_path)
    with simulated(scenario) as (_, ready):
        config = shortened(configured(ready, tmp_path), positions)
        state = tmp_path / "state"
        kill_calibration(tmp_path, config, lambda: proving(state))
        run_id = stored_run(state).row.run_id
        restored = finished(volcal(tmp_path, "resume", "--restore", "--config", str(config)))
        assert (restored["run_id"], restored["found"]) == (run_id, "a new table acts that was never proved")
        assert (restored["done"], restored["active_bank"]) == ("the former table acts again", 0)
        again = finished(volcal(tmp_path, "resume", "--restore", "--config", str(config)))
        assert again["done"] == "nothing had to be done"
        outcome = finished(volcal(tmp_path, "resume", "--config", str(config)))
    assert outcome["state"] == "complete"
    assert outcome["table_bank"] != 0


def proving(state: Path) -> bool:
    return balls_in(state) > 0 and any(step.key.startswith("verify/station-1/") for step in stored_run(state).steps)
