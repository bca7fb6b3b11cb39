"""Drives and buses that fail in the middle of a turn, told to do so in the simulator's process, met in this one."""

from __future__ import annotations

import json
import socket
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest

from agent.cli.run_commands.simulator_process import SimulatorProcess
from drivers.canopen_mount.mount import CanopenMount
from drivers.canopen_mount.settings import CanopenMountSettings
from drivers.clock import InterruptibleClock, LockstepClock
from drivers.errors import DeadlineExpired, LinkLost, LinkTimeout, MotionFault
from drivers.registry import DeviceContext

SCENARIO = Path(__file__).resolve().parents[2] / "config" / "simulators" / "case-study.toml"
AXIS = {
    "encoder_counts_per_revolution": 131072,
    "gear_motor_revolutions": 100,
    "lower_deg": -180.0,
    "upper_deg": 180.0,
    "speed_deg_per_s": 20.0,
    "acceleration_deg_per_s2": 40.0,
}
BOTH = pytest.mark.parametrize("kind", ["slcan", "socketcand"])


@dataclass
class Due:
    """Commands to the simulator that are due at given machine times."""

    clock: LockstepClock
    control: tuple[str, int]
    waiting: list[tuple[float, dict[str, Any]]] = field(default_factory=list)

    def say(self, request: dict[str, Any]) -> dict[str, Any]:
        with socket.create_connection(self.control, timeout=600.0) as link:
            link.sendall(json.dumps(request).encode() + b"\n")
            answer: dict[str, Any] = json.loads(link.makefile().readline())
        return answer

    def check(self) -> None:
        while self.waiting and self.clock.now() >= self.waiting[0][0]:
            assert "error" not in self.say(self.waiting.pop(0)[1])


@dataclass
class Bench:
    mount: CanopenMount
    clock: LockstepClock
    due: Due

    def drive(self, fault: str, node: int = 1) -> None:
        said = {"node": node, "fault": fault}
        assert self.due.say({"do": "drive", **said}) == {"done": "drive", **said}

    def in_a_second(self, fault: str, node: int = 1) -> None:
        self.due.waiting.append((self.clock.now() + 1.0, {"do": "drive", "node": node, "fault": fault}))

    def turn(self) -> None:
        self.mount.orient_to(90.0, 45.0)


@contextmanager
def bench(kind: str, directory: Path) -> Iterator[Bench]:
    channel = {"slcan": f"slcan:{directory / 'can'}", "socketcand": "socketcand:127.0.0.1:0"}[kind]
    with SimulatorProcess(SCENARIO, can=channel, log=directory / "simulator.log") as simulator:
        ready = simulator.ready
        clock = LockstepClock(ready["time"]["host"], ready["time"]["port"])
        settings = CanopenMountSettings.model_validate(
            {
                **ready["can"],
                "sdo_timeout_s": 1.0,
                "azimuth": {**AXIS, "node_id": 1},
                "elevation": {**AXIS, "node_id": 2},
            }
        )
        due = Due(clock, (ready["control"]["host"], ready["control"]["port"]))
        mount = CanopenMount(settings, DeviceContext("mount", InterruptibleClock(clock, due.check), directory))
        try:
            mount.open()
            yield Bench(mount, clock, due)
        finally:
            mount.close()
            clock.close()


@BOTH
def test_faults_of_drives_are_met_by_name_and_mended(kind: str, tmp_path: Path) -> None:
    with bench(kind, tmp_path) as over:
        over.turn()
        over.mount.orient_to(0.0, 0.0)
        for fault, error, words in (
            ("following_error", MotionFault, "0x8611 following error"),
            ("too_hot", MotionFault, "emergency message.*0x4210 device too hot"),
            ("positive_limit", MotionFault, "positive limit switch is active"),
            ("jam", DeadlineExpired, r"to reach its target.*following error \d"),
            ("restart", MotionFault, "has restarted"),
        ):
            over.in_a_second(fault)
            with pytest.raises(error, match=words):
                over.turn()
            over.clock.sleep(3.0)
            stopped = over.mount.orientation()
            over.clock.sleep(3.0)
            assert over.mount.orientation() == stopped, fault
            over.drive("mend")
            over.mount.orient_to(0.0, 0.0)


@BOTH
def test_silent_drive(kind: str, tmp_path: Path) -> None:
    with bench(kind, tmp_path) as over:
        over.in_a_second("silence", node=2)
        with pytest.raises(LinkTimeout, match="no SDO response from node 2"):
            over.turn()
        over.drive("mend", node=2)
        over.turn()


def test_drives_are_stopped_over_a_new_connection_after_bus_off(tmp_path: Path) -> None:
    with bench("socketcand", tmp_path) as over:
        over.in_a_second("bus_off")
        with pytest.raises(LinkLost, match="gone off the bus") as caught:
            over.turn()
        assert not hasattr(caught.value, "__notes__")  # a note says that the quick stop failed
        over.mount.open()
        over.clock.sleep(3.0)
        stopped = over.mount.orientation()
        assert stopped.azimuth_deg < 85.0
        over.clock.sleep(3.0)
        assert over.mount.orientation() == stopped


def test_bus_off_behind_an_adapter_that_stays_connected(tmp_path: Path) -> None:
    with bench("slcan", tmp_path) as over:
        over.in_a_second("bus_off")
        with pytest.raises(LinkTimeout, match="the adapter reports error warning, error passive, bus error") as caught:
            over.turn()
        assert any("quick stop failed too" in note for note in caught.value.__notes__)


def test_requests_that_name_nothing(tmp_path: Path) -> None:
    with bench("socketcand", tmp_path) as over:
        for request, words in (
            ({"do": "drive", "node": 9, "fault": "jam"}, "no drive at node 9"),
            ({"do": "drive", "node": 1, "fault": "sulk"}, "unknown fault 'sulk'"),
            ({"do": "drive", "node": True, "fault": "jam"}, "integer"),
            ({"do": "drive", "node": 1, "fault": "jam", "for": 3}, "unknown key 'for'"),
        ):
            assert words in over.due.say(request)["error"]
