"""Tests of the mount driver with simulated drives on a virtual bus and a virtual clock."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path

import pytest
from canopen_rig import Rig, axis_settings, rig
from pydantic import BaseModel

from agent.errors import Aborted
from agent.execution.supervisor import Supervisor
from drivers.canopen_mount.mount import CanopenMount
from drivers.canopen_mount.plugin import PLUGIN
from drivers.clock import InterruptibleClock, VirtualClock
from drivers.errors import (
    CommandRejected,
    ConfigurationError,
    DeadlineExpired,
    LinkLost,
    LinkTimeout,
    MotionFault,
    ProtocolError,
)
from drivers.links.can_bus import CanNetworks
from drivers.registry import DeviceContext
from drivers.roles import HoldableMount, Orientation, RotaryMount
from simulators.wire.can.drive import PowerDriveState


def at(clock: VirtualClock, instant_s: float, action: object) -> None:
    """Run an action once, when the machine time reaches an instant."""
    done: list[bool] = []

    def listener(now_s: float) -> None:
        if now_s >= instant_s and not done:
            done.append(True)
            action()  # type: ignore[operator]

    clock.subscribe(listener)


def quick_stopped(seen: list[tuple[int, bytes]], node_id: int) -> bool:
    return (0x600 + node_id, bytes.fromhex("2B 40 60 00 02 00 00 00")) in seen


def both_stopped(bench: Rig) -> bool:
    seen = bench.frames()
    return quick_stopped(seen, 5) and quick_stopped(seen, 6) and not bench.axes.turns


def test_it_implements_its_role() -> None:
    with rig(opened=False) as bench:
        assert isinstance(bench.mount, RotaryMount)
        assert isinstance(bench.mount, HoldableMount)
        assert isinstance(PLUGIN.create(bench.settings, DeviceContext("m", bench.clock, Path())), CanopenMount)


def test_turn_in_frames() -> None:
    with rig() as bench:
        bench.mount.orient_to(0.0, 0.0)
        bench.frames()
        reached = bench.mount.orient_to(90.0, -30.0)
        downloads = [
            (identifier & 0x7F, data)
            for identifier, data in bench.frames()
            if identifier in (0x605, 0x606) and data[0] != 0x40
        ]
    assert reached == Orientation(90.0, -30.0)
    assert downloads == [
        (5, bytes.fromhex("23 7A 60 00 90 5F 01 00")),  # 90000 counts
        (5, bytes.fromhex("2B 40 60 00 3F 00 00 00")),
        (5, bytes.fromhex("2B 40 60 00 0F 00 00 00")),
        (6, bytes.fromhex("23 7A 60 00 D0 8A FF FF")),  # -30000 counts
        (6, bytes.fromhex("2B 40 60 00 3F 00 00 00")),
        (6, bytes.fromhex("2B 40 60 00 0F 00 00 00")),
    ]


def test_profile_is_set_in_counts() -> None:
    with rig() as bench:
        bench.frames()
        bench.mount.orient_to(1.0, 1.0)
        seen = bench.frames()
    assert (0x605, bytes.fromhex("2F 60 60 00 01 00 00 00")) in seen
    assert (0x605, bytes.fromhex("23 81 60 00 10 27 00 00")) in seen  # 10000 counts/s
    assert (0x605, bytes.fromhex("23 83 60 00 50 C3 00 00")) in seen  # 50000 counts/s²
    assert (0x605, bytes.fromhex("23 84 60 00 50 C3 00 00")) in seen


def test_turn_takes_its_time_and_few_round_trips() -> None:
    with rig() as bench:
        bench.mount.orient_to(0.0, 0.0)
        bench.frames()
        start = bench.clock.now()
        bench.mount.orient_to(90.0, 0.0)
        requests = [identifier for identifier, _ in bench.frames() if identifier in (0x605, 0x606)]
        assert bench.clock.now() - start == pytest.approx(9.2 + 0.5, abs=0.05)
    assert len(requests) < 60


def test_opening_moves_nothing_and_starts_heartbeats() -> None:
    with rig(opened=False) as bench:
        bench.frames()
        bench.mount.open()
        bench.mount.open()
        seen = bench.frames()
        assert bench.azimuth.state is PowerDriveState.SWITCH_ON_DISABLED
        assert (0x000, bytes.fromhex("01 05")) in seen
        assert seen.count((0x605, bytes.fromhex("2B 17 10 00 F4 01 00 00"))) == 1
        assert bench.writes(5, 0x6040) == []


def test_offset_direction_and_gear() -> None:
    """Counts increase as the angle decreases, with zero counts at 90 degrees: 60 degrees is +30000 counts."""
    with rig(azimuth={"direction": -1, "offset_deg": 90.0, "upper_deg": 120.0, "lower_deg": 0.0}) as bench:
        bench.frames()
        assert bench.mount.orientation().azimuth_deg == 90.0
        assert bench.mount.orient_to(60.0, 0.0).azimuth_deg == 60.0
        assert bench.writes(5, 0x607A) == [bytes.fromhex("30 75 00 00")]


def test_limits_are_refused_before_anything_is_sent() -> None:
    with rig(azimuth={"upper_deg": 95.0}) as bench:
        bench.frames()
        with pytest.raises(CommandRejected, match=r"azimuth 95.5 degrees is outside the limits -180 ... 95"):
            bench.mount.orient_to(95.5, 0.0)
        with pytest.raises(CommandRejected, match="elevation nan"):
            bench.mount.orient_to(0.0, float("nan"))
        assert bench.frames() == []


def test_stuck_drive_runs_into_its_deadline_and_both_are_stopped() -> None:
    with rig(turn_margin_s=2.0) as bench:
        bench.elevation.jam()
        with pytest.raises(DeadlineExpired, match="elevation to reach its target") as caught:
            bench.mount.orient_to(20.0, 10.0)
        assert caught.value.where["node"] == "6"
        assert caught.value.where["device"] == "mount"
        assert bench.clock.now() == pytest.approx(1.5 * 2.2 + 2.0, abs=0.5)
        assert both_stopped(bench)
        bench.elevation.jam(jammed=False)
        assert bench.mount.orient_to(20.0, 10.0) == Orientation(20.0, 10.0)


def test_fault_in_a_turn_names_the_emergency() -> None:
    with rig() as bench:
        at(bench.clock, 3.0, lambda: bench.azimuth.trip(0x8611))
        with pytest.raises(MotionFault, match="0x8611 following error") as caught:
            bench.mount.orient_to(90.0, 0.0)
        assert caught.value.where["axis"] == "azimuth"
        assert bench.clock.now() < 3.5
        assert both_stopped(bench)


def test_following_error_without_a_fault() -> None:
    with rig() as bench:
        at(bench.clock, 2.0, bench.elevation.deviate)
        with pytest.raises(MotionFault, match=r"following error \(statusword bit 13\)"):
            bench.mount.orient_to(90.0, 60.0)
        assert both_stopped(bench)


@pytest.mark.parametrize("exchange", range(1, 9))
def test_request_with_a_lost_answer_is_repeated(exchange: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """For any lost SDO answer during a turn, the set-point is accepted once and the turn ends."""
    with rig(sdo_timeout_s=0.5) as bench:
        bench.mount.orient_to(0.0, 0.0)
        bench.axes.commands.clear()
        answered = []
        receive = bench.azimuth_node.receive

        def receive_and_count(identifier: int, data: bytes) -> list[tuple[int, bytes]]:
            if identifier == 0x605 and data[0] != 0x80:
                answered.append(data)
                bench.azimuth_node.lose_answers(int(len(answered) == exchange))
            return receive(identifier, data)

        monkeypatch.setattr(bench.azimuth_node, "receive", receive_and_count)
        assert bench.mount.orient_to(10.0, 0.0) == Orientation(10.0, 0.0)
        assert [command for command in bench.axes.commands if command[0] == "azimuth"] == [("azimuth", 10.0, 10.0)]


def test_fault_is_reset_once_when_the_mount_is_next_turned() -> None:
    with rig() as bench:
        bench.azimuth.trip(0x3220)
        bench.frames()
        assert bench.mount.orient_to(5.0, 0.0) == Orientation(5.0, 0.0)
        assert (0x605, bytes.fromhex("2B 40 60 00 80 00 00 00")) in bench.frames()


def test_fault_that_stays_is_a_motion_fault() -> None:
    with rig() as bench:
        bench.azimuth.trip(0x7305, persistent=True)
        with pytest.raises(MotionFault, match="cannot be reset: 0x7305 incremental encoder 1"):
            bench.mount.orient_to(5.0, 0.0)
        assert bench.axes.commands == []


def test_tolerated_emergency_does_not_end_the_turn() -> None:
    with rig(tolerated_emergencies=[0x4210]) as bench:
        at(bench.clock, 1.0, lambda: bench.azimuth.warn(0x4210))
        assert bench.mount.orient_to(30.0, 0.0) == Orientation(30.0, 0.0)


def test_not_settled_within_the_window() -> None:
    with rig(in_position_timeout_s=1.0) as bench:
        bench.axes.offset_deg = 0.008  # inside the drive's window, outside ours
        text = (
            r"elevation target 0\.0000 degrees, reported 0\.0080 degrees, off by \+0\.0080 degrees, "
            r"limit 0\.005 degrees \(in_position_deg\) .*axis elevation"
        )
        with pytest.raises(MotionFault, match=text):
            bench.mount.orient_to(10.0, 0.0)
        assert both_stopped(bench)


def test_restart_in_a_turn_is_a_fault() -> None:
    with rig() as bench:
        at(bench.clock, 2.0, lambda: bench.server.restart(bench.elevation_node))
        with pytest.raises(MotionFault, match="has restarted") as caught:
            bench.mount.orient_to(90.0, 60.0)
        assert caught.value.where["node"] == "6"
        bench.frames()
        assert bench.mount.orient_to(10.0, 10.0) == Orientation(10.0, 10.0)
        assert (0x606, bytes.fromhex("2B 17 10 00 F4 01 00 00")) in bench.frames(), "heartbeat set again"


def test_restart_between_turns_is_a_fault_too() -> None:
    with rig() as bench:
        bench.mount.orient_to(10.0, 0.0)
        bench.server.restart(bench.azimuth_node)
        with pytest.raises(MotionFault, match="has restarted"):
            bench.mount.orient_to(20.0, 0.0)


def test_silent_drive_is_a_timeout_that_says_what_to_check() -> None:
    with rig(sdo_timeout_s=0.5) as bench:

        def power_off() -> None:
            bench.azimuth_node.silent = True

        at(bench.clock, 2.0, power_off)
        with pytest.raises(LinkTimeout, match="no SDO response from node 5 to 0x6041:00 statusword") as caught:
            bench.mount.orient_to(90.0, 60.0)
        assert "powered" in caught.value.hint
        assert caught.value.where["link"].startswith("virtual:rig-")
        assert quick_stopped(bench.frames(), 6), "the other drive is stopped all the same"
        assert caught.value.__notes__


def test_late_heartbeat_is_checked_by_sdo() -> None:
    with rig() as bench:
        bench.azimuth_node.stop_heartbeat()
        assert bench.mount.impairments() == []
        assert bench.mount.orient_to(90.0, 0.0) == Orientation(90.0, 0.0)
        (text,) = bench.mount.impairments()
        assert "azimuth (node 5) sends no heartbeat, but still answers" in text
        bench.mount.close()
        bench.mount.open()
        assert bench.mount.impairments() == []


def test_heartbeat_loss_of_a_drive_that_is_no_longer_polled() -> None:
    """The elevation has reached its target and is no longer polled; its missing heartbeat reveals the failure."""
    with rig(sdo_timeout_s=0.5) as bench:

        def power_off() -> None:
            bench.elevation_node.silent = True

        at(bench.clock, 3.0, power_off)
        with pytest.raises(LinkTimeout, match="no SDO response from node 6"):
            bench.mount.orient_to(150.0, 5.0)
        assert bench.clock.now() < 3.0 + 2.0 + 0.9
        assert quick_stopped(bench.frames(), 5)


def test_drive_that_loses_its_power_stage() -> None:
    with rig() as bench:
        at(bench.clock, 2.0, bench.azimuth.reset)
        with pytest.raises(MotionFault, match="left operation enabled, it is in switch on disabled"):
            bench.mount.orient_to(90.0, 0.0)


def test_abort_stops_both_drives_without_sleeping() -> None:
    with rig(opened=False) as bench:

        def check() -> None:
            if bench.clock.now() > 1.0:
                raise Aborted("somebody asked for it")

        context = DeviceContext("mount", InterruptibleClock(bench.clock, check), Path())
        mount = CanopenMount(bench.settings, context, bench.networks)
        mount.open()
        try:
            with pytest.raises(Aborted):
                mount.orient_to(90.0, 30.0)
            assert both_stopped(bench)
        finally:
            mount.close()


@contextmanager
def held(bench: Rig, from_s: float, until_s: float) -> Iterator[CanopenMount]:
    """Open a mount whose turn is held between two instants."""
    supervisor = Supervisor(bench.clock)
    context = DeviceContext("mount", InterruptibleClock(bench.clock, supervisor.check), Path())
    mount = CanopenMount(bench.settings, context, bench.networks)
    supervisor.on_hold, supervisor.on_resume = mount.hold_turn, mount.resume_turn
    at(bench.clock, from_s, supervisor.request_hold)
    at(bench.clock, until_s, supervisor.request_resume)
    mount.open()
    with closing(mount):
        yield mount


def test_held_turn_stands_still_and_ends_at_its_target_when_it_is_resumed() -> None:
    with rig(opened=False) as bench, held(bench, 3.0, 600.0) as mount:
        angles: list[float] = []
        for instant_s in (3.5, 599.0):
            at(bench.clock, instant_s, lambda: angles.append(bench.axes.position_deg("azimuth")))
        reached = mount.orient_to(90.0, 30.0)
        assert 20.0 < angles[0] < 40.0
        assert angles[1] == angles[0]
        assert (reached.azimuth_deg, reached.elevation_deg) == (90.0, 30.0)
        assert 600.0 < bench.clock.now() < 610.0


def test_hold_that_is_requested_before_a_turn_stops_it_at_its_start() -> None:
    with rig(opened=False) as bench, held(bench, 0.0, 600.0) as mount:
        bench.clock.sleep(0.1)
        angles: list[float] = []
        at(bench.clock, 599.0, lambda: angles.append(bench.axes.position_deg("azimuth")))
        reached = mount.orient_to(90.0, 30.0)
        assert angles == [0.0]
        assert (reached.azimuth_deg, reached.elevation_deg) == (90.0, 30.0)


def test_hold_sends_nothing_without_a_turn_and_enables_no_drive() -> None:
    with rig() as bench:
        bench.mount.orient_to(10.0, 0.0)
        bench.frames()
        bench.mount.hold_turn()
        bench.mount.resume_turn()
        assert bench.frames() == []

        def cut_and_hold() -> None:
            bench.azimuth.trip(0x7121)
            bench.mount.hold_turn()

        at(bench.clock, bench.clock.now() + 2.0, cut_and_hold)
        with pytest.raises(MotionFault, match="motor blocked"):
            bench.mount.orient_to(90.0, 0.0)
        assert bench.azimuth.state is PowerDriveState.FAULT


def test_stop_from_another_thread_ends_the_turn() -> None:
    with rig() as bench:

        def press() -> None:
            thread = threading.Thread(target=bench.mount.stop)
            thread.start()
            thread.join(5.0)

        at(bench.clock, 2.0, press)
        with pytest.raises(MotionFault, match="left operation enabled"):
            bench.mount.orient_to(90.0, 0.0)
        assert bench.axes.position_deg("azimuth") < 30.0
        bench.mount.stop()


def test_stop_is_harmless_when_closed() -> None:
    with rig(opened=False) as bench:
        bench.mount.stop()
        with pytest.raises(LinkLost, match="not open"):
            bench.mount.orient_to(0.0, 0.0)


HOMING = {"homing": {"method": 1, "search_speed_deg_per_s": 5.0}}


def test_homing_comes_before_turning() -> None:
    with rig(azimuth=HOMING) as bench:
        with pytest.raises(CommandRejected, match="azimuth has not been homed"):
            bench.mount.orient_to(10.0, 0.0)
        bench.axes.at["azimuth"] = 20.0
        bench.frames()
        bench.mount.home()
        seen = bench.frames()
        for expected in (
            "2F 60 60 00 06 00 00 00",
            "2F 98 60 00 01 00 00 00",
            "23 99 60 01 88 13 00 00",  # 5000 counts/s
            "23 99 60 02 E8 03 00 00",  # 1000 counts/s
            "23 9A 60 00 20 4E 00 00",  # 20000 counts/s²
            "2B 40 60 00 1F 00 00 00",
        ):
            assert (0x605, bytes.fromhex(expected)) in seen
        assert bench.axes.commands == [("azimuth", 0.0, 5.0)]
        assert bench.mount.orient_to(10.0, 0.0) == Orientation(10.0, 0.0)


def test_homing_that_does_not_end() -> None:
    with rig(azimuth={"homing": {"method": 1, "timeout_s": 10.0}}) as bench:
        bench.axes.at["azimuth"] = 20.0
        bench.azimuth.jam()
        with pytest.raises(DeadlineExpired, match="homing to end"):
            bench.mount.home()
        assert both_stopped(bench)
        with pytest.raises(CommandRejected, match="has not been homed"):
            bench.mount.orient_to(10.0, 0.0)


def test_restart_loses_the_reference() -> None:
    with rig(azimuth=HOMING) as bench:
        bench.mount.home()
        bench.server.restart(bench.azimuth_node)
        with pytest.raises(MotionFault, match="home the mount again"):
            bench.mount.orient_to(10.0, 0.0)
        with pytest.raises(CommandRejected, match="has not been homed"):
            bench.mount.orient_to(10.0, 0.0)


def test_no_drive_at_the_node_id() -> None:
    with rig(opened=False, azimuth={"node_id": 9}, sdo_timeout_s=0.5) as bench:
        with pytest.raises(LinkTimeout, match="no SDO response from node 9 to 0x1000:00 device type"):
            bench.mount.open()
        assert not bench.mount.diagnose()[0].ok


def test_wrong_drive_at_the_node_id() -> None:
    with (
        rig(opened=False, azimuth={"vendor_id": 0x1234}) as bench,
        pytest.raises(ProtocolError, match=r"0x1018:01 vendor id is 0x3E7, expected 0x1234"),
    ):
        bench.mount.open()


def test_two_mounts_do_not_share_a_drive() -> None:
    with rig() as bench:
        other = CanopenMount(bench.settings, DeviceContext("other", bench.clock, Path()), bench.networks)
        with pytest.raises(ConfigurationError, match="two devices claim CANopen node 5"):
            other.open()
        assert bench.mount.orientation() == Orientation(0.0, 0.0)


def test_diagnosis_reads_only() -> None:
    with rig(opened=False) as bench:
        bench.frames()
        findings = bench.mount.diagnose()
        requests = [data for identifier, data in bench.frames() if identifier in (0x605, 0x606)]
        assert all(data[0] in (0x40, 0x60, 0x70) for data in requests), "uploads and their segments"
        assert not any(identifier == 0x000 for identifier, _ in bench.frames())
        assert all(finding.ok for finding in findings)
        text = " | ".join(finding.text for finding in findings if "node 5" in finding.subject)
        for expected in (
            "SDO round trip",
            "vendor 0x000003E7",
            "switch on disabled",
            "at 0.0000 degrees",
            "heartbeat off",
        ):
            assert expected in text


def test_diagnosis_names_a_fault() -> None:
    with rig() as bench:
        bench.elevation.trip(0x2310)
        bad = [finding for finding in bench.mount.diagnose() if not finding.ok]
        assert [(finding.subject, finding.text) for finding in bad] == [
            ("elevation drive (node 6)", "statusword 0x0608, fault: 0x2310 continuous over-current")
        ]


def test_close_switches_the_power_off() -> None:
    with rig() as bench:
        bench.mount.orient_to(1.0, 1.0)
        bench.mount.close()
        assert bench.azimuth.state is PowerDriveState.SWITCH_ON_DISABLED
        assert bench.elevation.state is PowerDriveState.SWITCH_ON_DISABLED
        bench.mount.open()
        assert bench.mount.orient_to(2.0, 2.0) == Orientation(2.0, 2.0)


EDS = """[FileInfo]
FileName=drive.eds
[DeviceInfo]
VendorName=x
VendorNumber=0x3E7
ProductName=y
ProductNumber={product}
[MandatoryObjects]
SupportedObjects=1
1=0x1000
[1000]
ParameterName=Device type
ObjectType=0x7
DataType=0x0007
AccessType=ro
PDOMapping=0
[OptionalObjects]
SupportedObjects={count}
{listed}
{objects}
"""


def write_eds(path: Path, product: str, indexes: dict[int, int]) -> None:
    listed = "\n".join(f"{number}=0x{index:04X}" for number, index in enumerate(indexes, start=1))
    objects = "\n".join(
        f"[{index:04X}]\nParameterName=o{index:X}\nObjectType=0x7\nDataType=0x{kind:04X}\nAccessType=rw\nPDOMapping=0"
        for index, kind in indexes.items()
    )
    path.write_text(EDS.format(product=product, count=len(indexes), listed=listed, objects=objects))


OBJECTS = {0x6040: 6, 0x6041: 6, 0x6060: 2, 0x6061: 2, 0x6064: 4, 0x607A: 4, 0x6081: 7}


def test_eds_gives_the_identity(tmp_path: Path) -> None:
    write_eds(tmp_path / "right.eds", "0x402", OBJECTS)
    write_eds(tmp_path / "wrong.eds", "0x403", OBJECTS)
    with rig(azimuth={"eds": str(tmp_path / "right.eds")}) as bench:
        assert bench.mount.orient_to(3.0, 0.0) == Orientation(3.0, 0.0)
    with (
        rig(opened=False, azimuth={"eds": str(tmp_path / "wrong.eds")}) as bench,
        pytest.raises(ProtocolError, match="product code is 0x402, expected 0x403"),
    ):
        bench.mount.open()


def test_eds_without_a_needed_object(tmp_path: Path) -> None:
    write_eds(tmp_path / "poor.eds", "0x402", {index: kind for index, kind in OBJECTS.items() if index != 0x607A})
    with (
        rig(opened=False, azimuth={"eds": str(tmp_path / "poor.eds")}) as bench,
        pytest.raises(ConfigurationError, match="does not list 0x607A:00 target position"),
    ):
        bench.mount.open()


def test_missing_eds_file(tmp_path: Path) -> None:
    with (
        rig(opened=False, elevation={"eds": str(tmp_path / "none.eds")}) as bench,
        pytest.raises(ConfigurationError, match=r"cannot be read.*none.eds"),
    ):
        bench.mount.open()


def test_settings_example_of_the_rig_is_strict() -> None:
    axis = PLUGIN.settings.model_fields["azimuth"].annotation
    assert isinstance(axis, type)
    assert issubclass(axis, BaseModel)
    assert set(axis_settings(5)) <= set(axis.model_fields)


def test_a_mount_in_use_by_another_program_is_not_looked_at(monkeypatch: pytest.MonkeyPatch) -> None:
    """Both would use the one SDO channel of a drive, and take each other's answers."""
    monkeypatch.setattr("drivers.canopen_mount.mount.LISTEN_S", 600.0)
    with rig() as bench:
        ended = threading.Event()

        def use() -> None:
            while not ended.is_set():
                bench.mount.orientation()

        other = CanopenMount(bench.settings, DeviceContext("look", bench.clock, Path()), CanNetworks())
        using = threading.Thread(target=use)
        using.start()
        try:
            with pytest.raises(CommandRejected, match=r"another program exchanges data with node [56]"):
                other.open_to_look()
        finally:
            ended.set()
            using.join(600.0)
        with pytest.raises(LinkLost, match="not open"):
            other.orientation()
        assert bench.mount.orientation() == Orientation(0.0, 0.0)
