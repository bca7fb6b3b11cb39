"""Contract of looks at the machine between runs, with a running stock LinuxCNC in conditions that a look must not
change."""

from __future__ import annotations

import json
import subprocess
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing
from typing import cast

import numpy as np
import pytest
from contract_rig import OPTIONS
from live import Live
from requirements import requires_linuxcnc

from drivers.contract.look_contract import LookOnlyContract, LookRig
from drivers.linuxcnc.bridge_link import BRIDGE
from drivers.linuxcnc.device import LinuxCnc
from drivers.roles import TableImage

pytestmark = [
    requires_linuxcnc,
]

FIRST_MM, SECOND_MM = np.array([1600.0, 0.0, 0.0]), np.array([1750.0, 10.0, 20.0])
TABLE = TableImage((0.0, 0.0, 0.0), (2000.0, 1300.0, 750.0), 1e-4, np.full((3, 2, 3, 3), 25, dtype=np.int32))
CONDITIONS: dict[str, tuple[str, ...]] = {
    "ready": (),
    "emergency stop": ("state(linuxcnc.STATE_ESTOP)",),
    "off": ("state(linuxcnc.STATE_OFF)",),
    "not homed": ("mode(linuxcnc.MODE_MANUAL)", "teleop_enable(0)", "unhome(-1)"),
}
STATE = """
import json, linuxcnc
s = linuxcnc.stat()
s.poll()
names = ("task_state", "task_mode", "interp_state", "exec_state", "state", "homed", "paused", "command", "file",
         "motion_mode", "enabled", "feedrate", "tool_in_spindle", "g5x_offset", "g92_offset", "gcodes", "position")
print(json.dumps([s.echo_serial_number, {name: getattr(s, name) for name in names}]))
"""
PINS = [f"volcal-tables.{name}" for name in ("bank", "acting-bank", "load-done", "load-sequence", "arm-bank")]


class LinuxCncLook(LookRig):
    """LinuxCNC with a table in bank 1. Its task counts the commands that it has received from anybody."""

    records_queries = False

    def __init__(self, live: Live, condition: str) -> None:
        self._live = live
        self.device = live.device(**OPTIONS)
        self._can_move = condition == "ready"
        self._commands = self._observe()[0]

    def read(self) -> object:
        cnc = cast(LinuxCnc, self.device)
        return cnc.active_bank(), cnc.pending_bank(), dict(cnc.temperatures_c()), cnc.status(), cnc.position().tolist()

    def read_tables(self) -> object:
        table = cast(LinuxCnc, self.device).read_table(1)
        assert table is not None
        assert table.same_as(TABLE)
        return table

    def commands(self) -> Sequence[Callable[[], object]]:
        cnc = cast(LinuxCnc, self.device)
        return (
            cnc.reset,
            cnc.hold,
            cnc.resume,
            cnc.home_axes,
            lambda: cnc.move_to(SECOND_MM, feed_mm_per_s=None, guarded=False),
            lambda: cnc.touch_towards(SECOND_MM, feed_mm_per_s=5.0),
            lambda: cnc.stage(2, TABLE),
            lambda: cnc.activate(0),
        )

    def received(self) -> list[str]:
        former, self._commands = self._commands, self._observe()[0]
        return [f"commands {former + 1} to {self._commands}"] if self._commands != former else []

    def is_query(self, received: str) -> bool:
        return False

    def state(self) -> object:
        with self._live.bystander() as hal:
            pins = hal.get_all(PINS)
        tables = sorted(self._live.process.work.joinpath("tables").iterdir())
        return self._observe()[1], pins, {file.name: file.read_bytes() for file in tables if file.is_file()}

    def _observe(self) -> tuple[int, dict[str, object]]:
        script = [*self._live.process.bridge_command, "-c", STATE]
        told = subprocess.run(script, check=True, capture_output=True, text=True, timeout=600.0).stdout
        count, state = json.loads(told.splitlines()[-1])
        return count, state

    def move_with_another_client(self, meanwhile: Callable[[], None]) -> None:
        if not self._can_move:
            return
        done: list[bool] = []

        def interrupt() -> None:
            if not done:
                done.append(True)
                meanwhile()

        other = self._live.device(interrupt=interrupt, **OPTIONS)
        other.open()
        with closing(other):
            done.clear()
            other.move_to(SECOND_MM, feed_mm_per_s=10.0, guarded=False)
            assert np.allclose(other.position(), SECOND_MM, atol=3e-3)
        assert done
        assert self.received()  # commands are counted


@pytest.fixture(params=CONDITIONS)
def look(request: pytest.FixtureRequest, live: Live) -> Iterator[LinuxCncLook]:
    with live.opened(homing="absolute-encoders", **OPTIONS) as cnc:
        cnc.activate(0)
        cnc.stage(1, TABLE)
        cnc.activate(1)
        cnc.move_to(FIRST_MM, feed_mm_per_s=None, guarded=False)
    live.by_hand(*CONDITIONS[request.param])
    made = LinuxCncLook(live, request.param)
    try:
        yield made
    finally:
        made.device.close()
        live.by_hand("state(linuxcnc.STATE_ESTOP_RESET)", "state(linuxcnc.STATE_ON)")


class TestLooks(LookOnlyContract):
    pass


def test_a_look_takes_no_message_from_the_panels(live: Live) -> None:
    live.by_hand("error_msg('a message for the operator')")
    device = live.device(**OPTIONS)
    device.open_to_look()
    with closing(device):
        device.status()
        device.status()
    with live.bystander() as panel:
        assert "a message for the operator" in panel.ask("status")["errors"]


@pytest.mark.parametrize("request_text", ["abort", "mdi", "mode", "home", "pause", "resume", "on", "hal_set"])
def test_the_bridge_itself_refuses_what_does_not_read(live: Live, request_text: str) -> None:
    request = json.dumps({"id": 1, "do": request_text, "mode": "manual", "line": "G0", "name": PINS[0], "value": 1})
    command = [*live.process.bridge_command, str(BRIDGE), "look"]
    told = subprocess.run(command, input=f"{request}\n", check=True, capture_output=True, text=True, timeout=600.0)
    answer = json.loads(told.stdout.splitlines()[-1])
    assert (answer["id"], answer["error"]) == (1, "refused")
    assert "only reads" in answer["text"]
