"""The real `volcal simulate` as a process of its own, and settings for an agent that is to reach it."""

from __future__ import annotations

import json
import subprocess
import sys
import time
import tomllib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from agent.execution.journal_reader import has_journal, open_journal
from drivers.errors import InputError

ROOT = Path(__file__).resolve().parents[2]
CONFIG = ROOT / "config"
SCENARIO = CONFIG / "simulators" / "case-study.toml"
COMMAND = [sys.executable, "-m", "agent.cli.main"]
PATIENCE_S = 600.0
SHORT_SET = "station,azimuth_deg,elevation_deg\n1,45,0\n1,0,45\n1,90,45\n"
"""Smallest position set at one station whose table removes more than its own uncertainty, if the machine is bad.

With two of its positions the predicted VCE is as large as the estimated VE, and the gate `gain` refuses the table.
"""


def scenario_text() -> str:
    """The text of the shipped scenario, with paths that hold in any directory."""
    return SCENARIO.read_text(encoding="utf-8").replace('"../', f'"{CONFIG}/')


@contextmanager
def simulated(scenario: Path = SCENARIO) -> Iterator[tuple[subprocess.Popen[bytes], dict[str, Any]]]:
    """The process and what it says when it is ready: where its links are."""
    command = [*COMMAND, "simulate", "--config", str(scenario), "--can", "socketcand:127.0.0.1:0", "--end-with-stdin"]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as process:
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
    if not has_journal(state):
        return 0
    try:
        with open_journal(state) as reader:
            run = reader.last_run()
            return 0 if run is None else reader.count_balls(run.run)
    except InputError:  # its tables are being made
        return 0


def wait_for(condition: Callable[[], Any], what: str, within_s: float = PATIENCE_S) -> Any:
    """Wait until `condition` holds and return its value."""
    deadline = time.monotonic() + within_s
    while True:
        asked = time.monotonic()
        if found := condition():
            return found
        answered = time.monotonic()
        assert answered < deadline, f"waited in vain for {what}"
        # an eighth of the time at most: what is asked needs the processors for what is waited for
        time.sleep(min(max(0.02, 7.0 * (answered - asked)), 0.5))


def wait_until(condition: Callable[[], bool], agent: subprocess.Popen[str]) -> None:
    """As long as the agent lives."""

    def reached() -> bool:
        found = condition()
        assert found or agent.poll() is None, agent.communicate()
        return found

    wait_for(reached, "what the agent measures")
