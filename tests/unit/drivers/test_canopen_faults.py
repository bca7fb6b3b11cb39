"""Tests of faults on the bus and in the drives: type and text of the error, and that both drives have stopped."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import can
import pytest
from canopen_rig import Rig, rig

from drivers.canopen_mount.mount import CanopenMount
from drivers.canopen_mount.plugin import PLUGIN
from drivers.canopen_mount.settings import CanopenMountSettings
from drivers.errors import CommandRejected, DeadlineExpired, DeviceError, LinkLost, MotionFault, ProtocolError
from drivers.links.can_bus import CanNetworks
from drivers.registry import DeviceContext, check_options
from drivers.roles import Orientation
from simulators.wire.can.drive import PowerDriveState

QUICK_STOPS = tuple((0x600 + node, bytes.fromhex("2B 40 60 00 02 00 00 00")) for node in (5, 6))
HOMING = {"homing": {"method": 1, "search_speed_deg_per_s": 5.0}}


def at(bench: Rig, instant_s: float, action: Callable[[], object]) -> None:
    """Run an action once, when the machine time reaches an instant."""
    done: list[float] = []

    def listener(now_s: float) -> None:
        if now_s >= instant_s and not done:
            done.append(now_s)
            action()

    bench.clock.subscribe(listener)


@contextmanager
def stopped_by(bench: Rig, kind: type[DeviceError], words: str, *, hint: str, axis: str = "azimuth") -> Iterator[None]:
    bench.frames()
    with pytest.raises(kind, match=words) as caught:
        yield
    assert type(caught.value) is kind
    assert hint in caught.value.hint
    assert caught.value.where["axis"] == axis
    assert caught.value.where["device"] == "mount"
    seen = bench.frames()
    assert all(stop in seen for stop in QUICK_STOPS)
    assert not bench.axes.turns


def turn(bench: Rig) -> None:
    bench.mount.orient_to(90.0, 30.0)


def test_emergency_message_without_a_fault() -> None:
    with rig() as bench:
        at(bench, 2.0, lambda: bench.azimuth.warn(0x4210))
        with stopped_by(bench, MotionFault, "emergency message.*0x4210 device too hot", hint="tolerated_emergencies"):
            turn(bench)
        assert bench.clock.now() < 2.7


def test_emergency_of_the_drive_that_already_reached_its_target() -> None:
    with rig() as bench:
        at(bench, 5.0, lambda: bench.elevation.trip(0x2310))
        with stopped_by(bench, MotionFault, "0x2310 continuous over-current", hint="cause", axis="elevation"):
            turn(bench)
        assert bench.clock.now() < 5.7


def test_emergency_at_rest_is_only_logged() -> None:
    with rig() as bench:
        bench.mount.orient_to(1.0, 1.0)
        bench.azimuth.warn(0x4210)
        bench.clock.sleep(0.1)
        assert bench.mount.orient_to(2.0, 2.0) == Orientation(2.0, 2.0)


def test_node_that_another_master_stops() -> None:
    with rig() as bench:
        at(bench, 2.0, lambda: bench.elevation_node.receive(0x000, bytes.fromhex("80 06")))
        with stopped_by(bench, MotionFault, "left the NMT state operational.*0x7F", hint="0x1029", axis="elevation"):
            turn(bench)


def test_restarted_node_is_started_again_before_the_next_turn() -> None:
    with rig() as bench:
        at(bench, 2.0, lambda: bench.elevation_node.receive(0x000, bytes.fromhex("80 06")))
        with pytest.raises(MotionFault):
            turn(bench)
        assert bench.mount.orient_to(1.0, 1.0) == Orientation(1.0, 1.0)


def test_homing_that_finds_no_switch() -> None:
    with rig(azimuth=HOMING) as bench:
        bench.axes.at["azimuth"] = 20.0
        bench.azimuth.lose_home_switch()
        with stopped_by(bench, MotionFault, r"homing failed \(statusword bit 13, method 1\)", hint="reference"):
            bench.mount.home()
        with pytest.raises(CommandRejected, match="has not been homed"):
            turn(bench)
        bench.azimuth.lose_home_switch(lost=False)
        bench.mount.home()
        assert bench.mount.orient_to(1.0, 1.0) == Orientation(1.0, 1.0)


def test_jammed_axis_reports_its_position() -> None:
    with rig(turn_margin_s=1.0) as bench:
        bench.azimuth.jam()
        words = r"azimuth to reach its target.*at 0.0000 of 90.0000 degrees, following error 90.0000 degrees \(0x60F4\)"
        with stopped_by(bench, DeadlineExpired, words, hint="jammed"):
            turn(bench)


def test_active_limit_switch_blocks_the_turn() -> None:
    with rig() as bench:
        at(bench, 3.0, lambda: bench.azimuth.press_limit_switch(1))
        with stopped_by(bench, MotionFault, "stopped at a limit.*positive limit switch is active", hint="switches"):
            turn(bench)
        assert 10.0 < bench.axes.position_deg("azimuth") < 40.0
        assert bench.mount.orient_to(0.0, 0.0) == Orientation(0.0, 0.0), "the way back is free"
        with pytest.raises(MotionFault, match="positive limit switch"):
            turn(bench)
        bench.azimuth.press_limit_switch(1, pressed=False)
        assert bench.mount.orient_to(20.0, 0.0) == Orientation(20.0, 0.0)


def test_switch_for_the_other_direction_does_not_block() -> None:
    with rig() as bench:
        at(bench, 2.0, lambda: bench.azimuth.press_limit_switch(-1))
        assert bench.mount.orient_to(40.0, 0.0) == Orientation(40.0, 0.0)


def test_software_limit_of_the_drive_is_refused_before_anything_is_sent() -> None:
    with rig(opened=False) as bench:
        bench.azimuth.parameters[0x607D, 1] = -45_000
        bench.azimuth.parameters[0x607D, 2] = 45_000
        bench.mount.open()
        bench.frames()
        with pytest.raises(CommandRejected, match=r"90 degrees is outside the drive's own software limits -45 ... 45"):
            turn(bench)
        assert bench.frames() == []
        assert bench.mount.orient_to(44.0, 0.0) == Orientation(44.0, 0.0)


def test_software_limit_changed_after_opening() -> None:
    with rig() as bench:
        bench.azimuth.parameters[0x607D, 1] = -45_000
        bench.azimuth.parameters[0x607D, 2] = 45_000
        words = r"target 90000 is outside the drive's software limits -45000 ... 45000 \(0x607D\)"
        with stopped_by(bench, MotionFault, words, hint="limits of the drive"):
            turn(bench)


def test_quick_stop_by_another_master() -> None:
    with rig() as bench:
        bench.azimuth.parameters[0x605A, 0] = 6  # stay in quick stop active
        stop = bytes.fromhex("2B 40 60 00 02 00 00 00")
        at(bench, 2.0, lambda: bench.azimuth_node.receive(0x605, stop))
        with stopped_by(
            bench, MotionFault, "made a quick stop, it is in quick stop active", hint="another CANopen master"
        ):
            turn(bench)
        bench.azimuth.parameters[0x605A, 0] = 2
        assert bench.mount.orient_to(1.0, 1.0) == Orientation(1.0, 1.0)


def test_bus_off_is_a_lost_link_and_the_mount_can_be_opened_again() -> None:
    with rig() as bench:
        bus_off = can.Message(arbitration_id=0x40, is_error_frame=True, data=bytes(8))
        at(bench, 2.0, lambda: bench.sniffer.send(bus_off))
        with pytest.raises(LinkLost, match="gone off the bus") as caught:
            turn(bench)
        assert "adapter" in caught.value.hint
        assert not bench.axes.turns, "the stop was sent over a new connection"
        bench.mount.close()
        bench.mount.open()
        bench.frames()
        assert bench.mount.orient_to(1.0, 1.0) == Orientation(1.0, 1.0)


def test_error_passive_is_only_a_warning() -> None:
    with rig() as bench:
        passive = can.Message(arbitration_id=0x04, is_error_frame=True, data=b"\x00\x20" + bytes(6))
        at(bench, 2.0, lambda: bench.sniffer.send(passive))
        assert bench.mount.orient_to(40.0, 0.0) == Orientation(40.0, 0.0)


def test_swapped_drives_are_detected_by_their_serial_numbers() -> None:
    with (
        rig(opened=False, azimuth={"serial_number": 1}, elevation={"serial_number": 4711}) as bench,
        pytest.raises(ProtocolError, match=r"0x1018:04 serial number is 0x1, expected 0x1267") as caught,
    ):
        bench.mount.open()
    assert "swapped" in caught.value.hint
    assert caught.value.where["axis"] == "elevation"
    assert bench.azimuth.state is PowerDriveState.SWITCH_ON_DISABLED


def test_claims_of_two_mounts_on_one_bus(tmp_path: Path) -> None:
    def mount(azimuth: int, elevation: int, **bus: object) -> dict[str, object]:
        axis = {
            "encoder_counts_per_revolution": 1000,
            "lower_deg": -90.0,
            "upper_deg": 90.0,
            "speed_deg_per_s": 10.0,
            "acceleration_deg_per_s2": 10.0,
        }
        where = {"interface": "slcan", "channel": "/dev/ttyACM0", "options": {"bitrate": 500_000}, **bus}
        return {**where, "azimuth": {**axis, "node_id": azimuth}, "elevation": {**axis, "node_id": elevation}}

    first = check_options("canopen-mount", mount(1, 2), "mount-1")
    assert set(first) == {"CANopen node 1 on slcan:/dev/ttyACM0", "CANopen node 2 on slcan:/dev/ttyACM0"}
    assert not set(first) & set(check_options("canopen-mount", mount(3, 4), "mount-2"))
    assert set(first) & set(check_options("canopen-mount", mount(3, 2), "mount-2"))
    elsewhere = mount(1, 2, channel="/dev/ttyACM1")
    assert not set(first) & set(PLUGIN.claims(CanopenMountSettings.model_validate(elsewhere)))


def test_diagnosis_does_not_switch_off_a_drive_that_another_process_turns() -> None:
    with rig() as bench:
        bench.mount.orient_to(1.0, 1.0)
        looking = CanopenMount(bench.settings, DeviceContext("doctor", bench.clock, Path()), CanNetworks())
        looking.open()
        assert all(finding.ok for finding in looking.diagnose())
        looking.close()
        assert bench.azimuth.state is PowerDriveState.ENABLED
        assert bench.elevation.state is PowerDriveState.ENABLED
