"""The simulator process killed in the middle of a calibration over its real links."""

from __future__ import annotations

import json
import os
import signal
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from journal_surgery import is_intact
from simulated import COMMAND, PATIENCE_S, balls_in, configured, simulated, wait_until
from stored_run import stored_run

from agent.runs.unfinished_run import unfinished_run

BALLS_BEFORE_THE_KILL = 5


@pytest.fixture
def simulator() -> Iterator[tuple[subprocess.Popen[bytes], dict[str, Any]]]:
    with simulated() as started:
        yield started


def test_killed_simulator_is_a_fault_that_names_link_and_step(simulator, tmp_path: Path) -> None:
    process, ready = simulator
    config = configured(ready, tmp_path)
    state = tmp_path / "state"
    arguments = ["calibrate", "--config", str(config), "--stations", "1", "--json"]
    with subprocess.Popen(
        [*COMMAND, *arguments],
        cwd=tmp_path,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    ) as agent:
        try:
            wait_until(lambda: balls_in(state) >= BALLS_BEFORE_THE_KILL, agent)
            process.kill()
            stdout, stderr = agent.communicate(timeout=PATIENCE_S)
        finally:
            agent.kill()
    assert agent.returncode == 3, stderr
    assert "Traceback" not in stderr
    [complaint] = [line for line in stderr.splitlines() if line.startswith("error:")]
    assert f"127.0.0.1:{ready['modbus']['port']}" in complaint
    assert "connection lost" in complaint  # seen by its end, not waited for
    assert "step measure/station-1/" in complaint
    document = json.loads(stdout)
    assert document["state"] == "faulted"
    assert document["balls"] >= BALLS_BEFORE_THE_KILL
    assert balls_in(state) == document["balls"]
    assert is_intact(state)
    run = stored_run(state)
    assert run.row.state == "faulted"
    [unfinished] = [step.key for step in run.steps if step.finished_s is None]
    assert unfinished in complaint


@pytest.mark.parametrize(
    ("number", "state_left", "reason", "resumable"),
    [(signal.SIGINT, "aborted", "aborted: SIGINT", False), (signal.SIGHUP, "faulted", "interrupted: SIGHUP", True)],
)
def test_a_run_whose_output_is_gone_is_left_safely(
    number: signal.Signals, state_left: str, reason: str, resumable: bool, simulator, tmp_path: Path
) -> None:
    """As `volcal calibrate 2>&1 | tee log` that Ctrl-C ends, and a connection to the computer that breaks off."""
    _, ready = simulator
    config, state = configured(ready, tmp_path), tmp_path / "state"
    reading, writing = os.pipe()
    arguments = ["calibrate", "--config", str(config), "--stations", "1"]
    with subprocess.Popen([*COMMAND, *arguments], cwd=tmp_path, stdout=writing, stderr=writing, text=True) as agent:
        try:
            os.close(writing)
            wait_until(lambda: balls_in(state) >= BALLS_BEFORE_THE_KILL, agent)
            os.close(reading)
            agent.send_signal(number)
            agent.wait(PATIENCE_S)
        finally:
            agent.kill()
    assert agent.returncode == 5
    assert is_intact(state)
    run = stored_run(state)
    assert run.row.state == state_left
    assert reason in (run.row.reason or "")
    assert run.row.ended is not None
    unfinished = unfinished_run(state)
    assert (unfinished is not None and unfinished.resumable) is resumable
    assert any(step.key == "recover/retreat" or step.key.startswith("recover/") for step in run.steps)
