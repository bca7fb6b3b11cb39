"""The simulator process killed in the middle of a calibration over its real links."""

from __future__ import annotations

import json
import sqlite3
import subprocess
import sys
import time
import tomllib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).resolve().parents[2]
CONFIG = ROOT / "config"
SCENARIO = CONFIG / "simulators" / "case-study.toml"
BALLS_BEFORE_THE_KILL = 5
PATIENCE_S = 45.0
FAULT_WITHIN_S = 3.0


@pytest.fixture
def simulator() -> Iterator[tuple[subprocess.Popen[bytes], dict[str, Any]]]:
    command = ["simulate", "--config", str(SCENARIO), "--can", "socketcand:127.0.0.1:0", "--end-with-stdin"]
    with subprocess.Popen(
        [sys.executable, "-m", "agent.cli.main", *command], stdin=subprocess.PIPE, stdout=subprocess.PIPE
    ) as process:
        try:
            assert process.stdout is not None
            yield process, json.loads(process.stdout.readline())
        finally:
            process.kill()


def configured(ready: dict[str, Any], directory: Path) -> Path:
    """The shipped settings with the addresses that the simulator got, as a file that an agent can be given."""
    text = (CONFIG / "case-study.toml").read_text()
    shipped = tomllib.loads(text)["devices"]
    can = ready["can"]["options"]
    for former, now in (
        ("port = 5021", f"port = {ready['time']['port']}"),
        (f"port = {shipped['cnc']['options']['port']}\n", f"port = {ready['modbus']['port']}\n"),
        (f"port = {shipped['operator']['options']['port']}\n", f"port = {ready['control']['port']}\n"),
        ("port = 29536", f"port = {can['port']}"),
        ('"machines/', f'"{CONFIG}/machines/'),
        ('"artefacts/', f'"{CONFIG}/artefacts/'),
        ('"../runs"', '"state"'),
    ):
        head, separator, tail = text.rpartition(former) if former.startswith("port") else text.partition(former)
        assert separator, former
        text = head + now + tail
    path = directory / "volcal.toml"
    path.write_text(text)
    return path


def balls_in(state: Path) -> int:
    """Counted through a connection of our own, while the agent writes."""
    if not (state / "journal.sqlite").exists():
        return 0
    connection = sqlite3.connect(f"file:{state / 'journal.sqlite'}?mode=ro", uri=True)
    try:
        return int(connection.execute("SELECT count(*) FROM balls").fetchone()[0])
    except sqlite3.OperationalError:
        return 0
    finally:
        connection.close()


def wait_until(condition: Callable[[], bool], agent: subprocess.Popen[str]) -> None:
    deadline = time.monotonic() + PATIENCE_S
    while not condition():
        assert agent.poll() is None, agent.communicate()
        assert time.monotonic() < deadline, "the agent measures nothing"
        time.sleep(0.02)


def test_killed_simulator_is_a_fault_that_names_link_and_step(simulator, tmp_path: Path) -> None:
    process, ready = simulator
    config = configured(ready, tmp_path)
    state = tmp_path / "state"
    arguments = ["calibrate", "--config", str(config), "--stations", "1", "--json"]
    with subprocess.Popen(
        [sys.executable, "-m", "agent.cli.main", *arguments],
        cwd=tmp_path,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    ) as agent:
        try:
            wait_until(lambda: balls_in(state) >= BALLS_BEFORE_THE_KILL, agent)
            process.kill()
            killed = time.monotonic()
            stdout, stderr = agent.communicate(timeout=20.0)
            took = time.monotonic() - killed
        finally:
            agent.kill()
    assert agent.returncode == 3, stderr
    assert took < FAULT_WITHIN_S
    assert "Traceback" not in stderr
    [complaint] = [line for line in stderr.splitlines() if line.startswith("error:")]
    assert f"127.0.0.1:{ready['modbus']['port']}" in complaint
    assert "step measure/station-1/" in complaint
    document = json.loads(stdout)
    assert document["state"] == "faulted"
    assert document["balls"] >= BALLS_BEFORE_THE_KILL
    assert balls_in(state) == document["balls"]
    connection = sqlite3.connect(state / "journal.sqlite")
    assert connection.execute("PRAGMA integrity_check").fetchone() == ("ok",)
    assert connection.execute("SELECT state FROM runs").fetchall() == [("faulted",)]
    unfinished = connection.execute("SELECT key FROM steps WHERE finished IS NULL AND begun IS NOT NULL").fetchall()
    connection.close()
    assert len(unfinished) == 1
    assert unfinished[0][0] in complaint
