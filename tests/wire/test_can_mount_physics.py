"""Drives in front of the mount's own physics: ramps, encoder and braking as in the world."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import can
import pytest

from drivers.canopen_mount.plugin import PLUGIN
from drivers.clock import VirtualClock
from drivers.errors import MotionFault
from drivers.registry import DeviceContext
from drivers.roles import Orientation
from simulators.scenario import MountBehaviour
from simulators.wire.can.drive import DriveConfig, drive_node
from simulators.wire.can.server import CanServer
from simulators.world.mount import MountPhysics

COUNTS_PER_DEGREE = 131072 * 80 / 360


class MovedPhysics:
    """Mount without the rest of the world, advanced by a clock."""

    def __init__(self) -> None:
        self.physics = MountPhysics(MountBehaviour(), 1, lambda: None)
        self.clock = VirtualClock()
        self.clock.subscribe(self._advance)

    def _advance(self, now_s: float) -> None:
        self.physics.now_s = now_s


@pytest.fixture
def moved() -> MovedPhysics:
    return MovedPhysics()


@pytest.fixture
def mount(moved: MovedPhysics, request: pytest.FixtureRequest) -> Iterator[object]:
    channel = request.node.name
    nodes = [
        drive_node(DriveConfig(node_id, axis, COUNTS_PER_DEGREE), moved.physics)[0]
        for node_id, axis in ((11, "azimuth"), (12, "elevation"))
    ]
    axis = {
        "encoder_counts_per_revolution": 131072,
        "gear_motor_revolutions": 80,
        "speed_deg_per_s": MountBehaviour().speed_deg_per_s,
        "acceleration_deg_per_s2": MountBehaviour().acceleration_deg_per_s2,
    }
    settings = PLUGIN.settings.model_validate(
        {
            "interface": "virtual",
            "channel": channel,
            "azimuth": {**axis, "node_id": 11, "lower_deg": -200.0, "upper_deg": 200.0},
            "elevation": {**axis, "node_id": 12, "lower_deg": -95.0, "upper_deg": 95.0},
        }
    )
    device = PLUGIN.create(settings, DeviceContext("mount", moved.clock, Path()))
    with CanServer(can.Bus(interface="virtual", channel=channel), nodes) as server:
        moved.clock.subscribe(server.advance)
        device.open()
        yield device
        device.close()


def test_turn_ends_when_the_ramps_say(moved: MovedPhysics, mount) -> None:
    reached = mount.orient_to(123.0, -45.0)
    assert reached.azimuth_deg == pytest.approx(123.0, abs=0.5 / COUNTS_PER_DEGREE)
    assert reached.elevation_deg == pytest.approx(-45.0, abs=0.5 / COUNTS_PER_DEGREE)
    speed, ramp = MountBehaviour().speed_deg_per_s, MountBehaviour().acceleration_deg_per_s2
    assert moved.clock.now() == pytest.approx(123.0 / speed + speed / ramp + 0.5, abs=0.1)


def test_same_place_twice_takes_no_turn(moved: MovedPhysics, mount) -> None:
    first = mount.orient_to(30.0, 10.0)
    start = moved.clock.now()
    assert mount.orient_to(30.0, 10.0) == first
    assert moved.clock.now() - start < 0.6


def test_stop_brakes_along_the_ramp(moved: MovedPhysics, mount) -> None:
    moved.clock.subscribe(lambda now_s: mount.stop() if 2.0 <= now_s < 2.5 else None)
    with pytest.raises(MotionFault, match="made a quick stop"):
        mount.orient_to(150.0, 0.0)
    moved.clock.sleep(5.0)
    resting: Orientation = mount.orientation()
    moved.clock.sleep(5.0)
    assert mount.orientation() == resting
    assert 0.0 < resting.azimuth_deg < 150.0
    assert mount.orient_to(0.0, 0.0).azimuth_deg == pytest.approx(0.0, abs=1e-3)


def test_physical_stop_is_a_fault_with_its_code(mount) -> None:
    with pytest.raises(MotionFault, match="0x8612 reference limit"):
        mount.orient_to(190.0, 0.0)
