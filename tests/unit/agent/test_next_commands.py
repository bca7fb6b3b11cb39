"""Commands that `volcal init` proposes to type next."""

from __future__ import annotations

from pathlib import Path

import pytest

from agent.planning.new_machine.answers import SetupAnswers
from agent.planning.new_machine.field import ProposalsOnly
from agent.runs.new_machine_files import next_commands

MILL = {"machine_class": "mill", "travel": "800 500 400"}
CONTROLLERS = {
    "modbus-cnc": {"controller": "modbus-cnc", "address": "127.0.0.1:1"},
    "serial-cnc": {"controller": "serial-cnc", "address": "/dev/nowhere"},
    "linuxcnc": {"controller": "linuxcnc"},
}


def commands(directory: Path, *, ready: bool, **texts: str) -> list[str]:
    setup = SetupAnswers({**MILL, **texts}, ProposalsOnly(), directory).collect()
    return next_commands(setup, directory, ready=ready)


@pytest.mark.parametrize("controller", CONTROLLERS)
def test_on_a_real_controller_the_line_ends_with_a_trial_that_writes_nothing(tmp_path: Path, controller: str) -> None:
    found = commands(tmp_path, ready=True, **CONTROLLERS[controller])
    assert found == [f"cd {tmp_path}", "volcal calibrate --simulated", "volcal doctor", "volcal try"]


@pytest.mark.parametrize("controller", ["modbus-cnc", None])
def test_after_a_refused_forecast_nothing_is_calibrated(tmp_path: Path, controller: str | None) -> None:
    found = commands(tmp_path, ready=False, **(CONTROLLERS[controller] if controller else {}))
    assert found == [f"cd {tmp_path}", "volcal plan"]


def test_a_directory_with_blanks_is_quoted(tmp_path: Path) -> None:
    assert commands(tmp_path / "hall 2", ready=True) == [f"cd '{tmp_path}/hall 2'", "volcal calibrate --simulated"]
