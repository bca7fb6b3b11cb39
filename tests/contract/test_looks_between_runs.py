"""Contract of looks at the machine between runs, on every driver that can be looked at and its simulator."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager
from functools import partial
from pathlib import Path

import pytest
from look_rigs import canopen, grbl, modbus

from drivers.contract.look_contract import LookOnlyContract, LookRig

Made = Callable[[Path, str], AbstractContextManager[LookRig]]
CONDITIONS: dict[str, tuple[Made, tuple[str, ...]]] = {
    "modbus": (modbus, ("ready", "emergency stop")),
    "modbus-rtu": (partial(modbus, rtu=True), ("ready", "emergency stop")),
    "grbl": (grbl, ("ready", "locked", "held", "half a line", "alarm of a limit")),
    "canopen": (canopen, ("not started", "used", "fault", "stopped")),
}
CASES = [
    pytest.param((made, condition), id=f"{name}: {condition}")
    for name, (made, conditions) in CONDITIONS.items()
    for condition in conditions
]


@pytest.fixture(params=CASES)
def look(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[LookRig]:
    made, condition = request.param
    with made(tmp_path, condition) as rig:
        yield rig


class TestLooks(LookOnlyContract):
    pass
