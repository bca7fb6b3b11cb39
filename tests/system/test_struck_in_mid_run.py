"""A machine that is struck in the middle of a calibration: the real command over real links."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from simulated import configured, scenario_text, simulated
from volcal_command import volcal_json

from drivers.clock import LockstepClock
from drivers.registry import DeviceContext, create_device
from drivers.roles import CompensationStore, TableImage

STRUCK_AT_MIN, STRUCK_URAD = 11.7, 30.0  # between two positions: within one, the drift of its first ball ends the run
FORMER_BANK = 1
FORMER_TABLE = TableImage((0.0, 0.0, 0.0), (2000.0, 650.0, 750.0), 1e-4, np.full((3, 3, 3, 3), 7, dtype=np.int32))


def struck_scenario(directory: Path) -> Path:
    """Write the shipped scenario with a collision that turns the column about Y while the run measures."""
    path = directory / "struck.toml"
    path.write_text(
        f"{scenario_text()}\n[ageing]\nnight = 1\ncollision_night = 1\ncollision_minute = {STRUCK_AT_MIN}\n"
        f"[ageing.collision]\nB0Z = {STRUCK_URAD}\n"
    )
    return path


@contextmanager
def banks_of_controller(ready: dict[str, Any], directory: Path) -> Iterator[CompensationStore]:
    """Open the controller's compensation banks as another program would."""
    with closing(LockstepClock(ready["time"]["host"], ready["time"]["port"])) as clock:
        device = create_device("modbus-cnc", ready["modbus"], DeviceContext("cnc", clock, directory))
        device.open()
        with closing(device):
            assert isinstance(device, CompensationStore)
            yield device


def test_the_table_is_refused_the_change_is_named_and_the_former_table_acts_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    with simulated(struck_scenario(tmp_path)) as (_, ready):
        config = configured(ready, tmp_path)
        head, section, tail = config.read_text().partition("[procedure]\n")
        assert section
        config.write_text(f"{head}{section}closing_positions = 2\n{tail}")
        with banks_of_controller(ready, tmp_path) as banks:
            banks.stage(FORMER_BANK, FORMER_TABLE)
            banks.activate(FORMER_BANK)
        found = volcal_json("calibrate", "--config", config, "--stations", "1,2", exit_code=4)
        with banks_of_controller(ready, tmp_path) as banks:
            assert banks.active_bank() == FORMER_BANK
            former = banks.read_table(FORMER_BANK)
    assert former is not None
    assert np.array_equal(former.counts, FORMER_TABLE.counts)
    assert found["state"] == "refused"
    [suspect] = found["step_in_run"]["suspects"]
    assert suspect["error"] == "B0Z"
    assert suspect["change"] == pytest.approx(STRUCK_URAD, rel=0.2)
