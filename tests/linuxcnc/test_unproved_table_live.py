"""The way out of an unproved table with a running stock LinuxCNC, as on the other links (tests/contract)."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from contract_rig import LinuxCncRig
from live import Live
from requirements import requires_linuxcnc
from unproved_table import RefusingStore, assert_given_up_and_settled, assert_restored_in_the_end

from agent.execution.rig import Rig

pytestmark = [
    requires_linuxcnc,
]


@pytest.fixture
def rig(live: Live) -> Iterator[Rig]:
    made = LinuxCncRig(live)
    made.device.open()
    store: Any = RefusingStore(made.store, 1)
    nobody: Any = None
    try:
        yield Rig({}, made.machine, made.probe, {}, store, made.thermometer, nobody, made.clock)
        made.leave()
    finally:
        made.device.close()


def test_a_restore_that_fails_some_times_is_tried_until_it_works(rig: Rig, tmp_path: Path) -> None:
    assert_restored_in_the_end(rig, tmp_path)


def test_if_a_restore_never_works_giving_up_names_the_operators_action_and_his_action_settles_it(
    rig: Rig, tmp_path: Path
) -> None:
    assert_given_up_and_settled(rig, tmp_path)
