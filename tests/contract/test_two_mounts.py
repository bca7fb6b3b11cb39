"""Tests of two mounts on one CAN bus: one link, two pairs of drives, independent devices."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
from rigs import ANY, channels, drives

from drivers.canopen_mount.mount import CanopenMount
from drivers.clock import Clock, LockstepClock
from drivers.errors import ConfigurationError, DeviceError
from drivers.links.can_bus import PROCESS_NETWORKS
from drivers.registry import DeviceContext, create_device
from simulators.scenario import read_scenario
from simulators.wire.wired_machine import Links, WiredMachine

SCENARIO = Path(__file__).resolve().parents[2] / "config" / "simulators" / "two-mounts.toml"


@dataclass
class Both:
    machine: WiredMachine
    ready: dict[str, Any]
    clock: Clock
    mounts: tuple[CanopenMount, CanopenMount]

    def true_deg(self, station: int) -> tuple[float, float]:
        return self.machine.world.mount_at(station).angles_deg()


@pytest.fixture(params=["virtual", "slcan:any"])
def both(request: pytest.FixtureRequest) -> Iterator[Both]:
    channel = f"virtual:contract-two-{next(channels)}" if request.param == "virtual" else request.param
    machine = WiredMachine(read_scenario(SCENARIO).without_errors(), Links(ANY, ANY, can=channel))
    machine.start()
    assert machine.time is not None
    clock = LockstepClock(*machine.time.address)
    ready = machine.ready_line()
    mounts = tuple(mount(ready, number, clock) for number in ("1", "2"))
    try:
        for one in mounts:
            one.open()
        yield Both(machine, ready, clock, mounts)  # type: ignore[arg-type]
    finally:
        for one in mounts:
            one.close()
        clock.close()
        machine.close()


def mount(ready: dict[str, Any], number: str, clock: Clock) -> CanopenMount:
    options = {**ready["can"], **drives(ready["can_mounts"][number])}
    device = create_device("canopen-mount", options, DeviceContext(f"mount-{number}", clock, Path()))
    assert isinstance(device, CanopenMount)
    return device


def test_the_ready_line_lists_the_nodes_of_each_mount(both: Both) -> None:
    assert both.ready["can_nodes"] == {"azimuth": 1, "elevation": 2}
    assert both.ready["can_mounts"] == {"1": {"azimuth": 1, "elevation": 2}, "2": {"azimuth": 3, "elevation": 4}}


def test_mounts_share_one_network_until_the_last_one_closes(both: Both) -> None:
    opened = PROCESS_NETWORKS._open
    assert len([address for address in opened if address.channel == both.ready["can"]["channel"]]) == 1
    first, second = both.mounts
    first.close()
    assert second.orient_to(10.0, 80.0).azimuth_deg == pytest.approx(10.0, abs=0.01)
    second.close()
    assert not [address for address in opened if address.channel == both.ready["can"]["channel"]]


def test_each_mount_turns_independently(both: Both) -> None:
    first, second = both.mounts
    turned = second.orient_to(-30.0, 20.0)
    assert (turned.azimuth_deg, turned.elevation_deg) == pytest.approx((-30.0, 20.0), abs=0.01)
    assert both.true_deg(2) == pytest.approx((-30.0, 20.0), abs=0.01)
    assert both.true_deg(1) == pytest.approx((0.0, 90.0))
    unmoved = first.orientation()
    assert (unmoved.azimuth_deg, unmoved.elevation_deg) == pytest.approx((0.0, 90.0), abs=0.01)


def test_stopping_one_does_not_affect_the_other(both: Both) -> None:
    first, second = both.mounts
    first.stop()
    assert second.orient_to(5.0, 85.0).elevation_deg == pytest.approx(85.0, abs=0.01)
    assert first.orient_to(5.0, 85.0).elevation_deg == pytest.approx(85.0, abs=0.01)


def test_diagnosis_covers_both_drives_of_each_mount(both: Both) -> None:
    for one, nodes in zip(both.mounts, ((1, 2), (3, 4)), strict=True):
        findings = one.diagnose()
        assert all(finding.ok for finding in findings)
        assert {finding.subject for finding in findings if "drive" in finding.subject} == {
            f"azimuth drive (node {nodes[0]})",
            f"elevation drive (node {nodes[1]})",
        }


def test_a_node_that_another_mount_has_is_refused_when_it_opens(both: Both) -> None:
    duplicate = mount(both.ready, "2", both.clock)
    with pytest.raises(ConfigurationError, match="two devices claim CANopen node 3"):
        duplicate.open()
    assert both.mounts[1].orientation().elevation_deg == pytest.approx(90.0, abs=0.01)


def test_a_mount_with_dead_drives_does_not_affect_the_other(both: Both) -> None:
    silent = create_device(
        "canopen-mount",
        {**both.ready["can"], **drives({"azimuth": 21, "elevation": 22}), "sdo_timeout_s": 0.05},
        DeviceContext("absent", both.clock, Path()),
    )
    with pytest.raises(DeviceError):
        silent.open()
    assert both.mounts[0].orient_to(1.0, 89.0).azimuth_deg == pytest.approx(1.0, abs=0.01)
