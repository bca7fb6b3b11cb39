"""The way out of an unproved table on each link: a restore that the controller refuses some times, or always."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from rigs import SimulatedRig, in_process, on_wires, over_rtu, over_serial
from unproved_table import RefusingStore, assert_given_up_and_settled, assert_restored_in_the_end

from agent.execution.rig import Rig


@pytest.fixture(
    params=[in_process, on_wires, over_rtu, over_serial], ids=["in-process", "modbus-tcp", "modbus-rtu", "serial-grbl"]
)
def wired(request: pytest.FixtureRequest) -> Iterator[SimulatedRig]:
    with request.param() as machine:
        yield machine


@pytest.fixture
def rig(wired: SimulatedRig) -> Rig:
    store: Any = RefusingStore(wired.store, 1)
    return Rig({}, wired.machine, wired.probe, {1: wired.mount}, store, wired.thermometer, wired.operator, wired.clock)


def test_a_restore_that_fails_some_times_is_tried_until_it_works(rig: Rig, tmp_path: Path) -> None:
    assert_restored_in_the_end(rig, tmp_path)


def test_if_a_restore_never_works_giving_up_names_the_operators_action_and_his_action_settles_it(
    rig: Rig, tmp_path: Path
) -> None:
    assert_given_up_and_settled(rig, tmp_path)
