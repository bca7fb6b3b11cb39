"""Tests of the serial CNC driver with a faulty GRBL: every fault gives a typed error, and the machine stops."""

from __future__ import annotations

import os
import termios
import threading
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from serial_rig import Rig, rig

from drivers.clock import ScaledClock
from drivers.errors import (
    CommandRejected,
    ConfigurationError,
    DeadlineExpired,
    GuardTripped,
    LinkLost,
    LinkTimeout,
    MotionFault,
    PermissionMissing,
    ProtocolError,
)
from drivers.links.serial_port import SerialAddress, SerialPort
from drivers.registry import DeviceContext
from drivers.roles import Miss, MotionState, Permission, Touch
from drivers.serial_cnc.conversation import Conversation
from drivers.serial_cnc.device import SerialCnc
from drivers.serial_cnc.settings import SerialCncSettings
from simulators.wire.grbl.dialect import GRBL_11, GRBL_HAL, GrblDialect
from simulators.wire.time_server import Ticker

FAR = np.array([1000.0, 0.0, 0.0])
FAST_HOMING = {25: 12000.0}


@pytest.fixture
def grbl(tmp_path: Path) -> Iterator[Rig]:
    with rig(tmp_path) as made:
        made.device.open()
        yield made


def stands_still(grbl: Rig) -> bool:
    """Return True if the machine comes to rest within three seconds and remains at rest."""
    grbl.clock.sleep(3.0)
    first = grbl.world.controller.displayed_position()
    grbl.clock.sleep(3.0)
    return bool(np.array_equal(first, grbl.world.controller.displayed_position()))


def go_far(grbl: Rig) -> None:
    grbl.device.move_to(FAR, feed_mm_per_s=50.0, guarded=False)


class TestFaultsOnTheLine:
    def test_garbled_report_is_asked_for_again(self, grbl: Rig) -> None:
        grbl.line.once(b"<Run", lambda line: line[:14] + b"\r\n")
        go_far(grbl)
        assert grbl.device.position() == pytest.approx(FAR)

    def test_report_garbled_again_and_again_is_an_error_and_a_stop(self, grbl: Rig) -> None:
        grbl.line.on_line = lambda line: b"\xff\xfe|\r\n" if line.startswith(b"<Run") else line
        with pytest.raises(ProtocolError, match="garbled"):
            go_far(grbl)
        assert stands_still(grbl)

    def test_lost_answer_is_detected(self, grbl: Rig) -> None:
        grbl.at(5.0, lambda: grbl.line.once(b"ok", lambda _: b""))
        with pytest.raises(ProtocolError, match="no answer to 'G4P0'"):
            go_far(grbl)
        assert stands_still(grbl)

    def test_cut_answer_is_an_error_and_a_stop(self, grbl: Rig) -> None:
        grbl.line.once(b"ok", lambda _: b"o\r\n")
        with pytest.raises(ProtocolError, match="garbled"):
            go_far(grbl)
        assert stands_still(grbl)

    def test_late_answer_is_a_timeout_and_not_assigned_to_another_line(self, grbl: Rig) -> None:
        late: list[bytes] = []

        def keep(line: bytes) -> bytes:
            late.append(line)
            return b""

        grbl.line.once(b"ok", keep)
        with pytest.raises(LinkTimeout, match="no answer to"):
            go_far(grbl)
        assert stands_still(grbl)
        grbl.device.status()
        grbl.port.line.send(late[0])
        grbl.device.status()
        go_far(grbl)
        assert grbl.device.position() == pytest.approx(FAR)

    def test_dtr_stays_set_when_the_port_is_closed(self, grbl: Rig) -> None:
        """Otherwise a board with automatic reset would restart with each program."""
        assert not termios.tcgetattr(grbl.port.line._theirs)[2] & termios.HUPCL

    def test_slow_overrides_give_a_motion_more_time(self, grbl: Rig) -> None:
        grbl.line.on_line = lambda line: line.replace(b"Ov:100,100,100", b"Ov:10,25,100")
        for _ in range(12):
            grbl.device.status()
        go_far(grbl)
        assert grbl.device.position() == pytest.approx(FAR)
        wrong = [finding for finding in grbl.device.diagnose() if not finding.ok]
        assert [finding.text for finding in wrong] == ["feed 10 %, rapids 25 %"]

    def test_doubled_answer_is_an_error(self, grbl: Rig) -> None:
        centre = grbl.before()
        grbl.line.once(b"ok", lambda line: line + line)
        with pytest.raises(ProtocolError, match="no line waits"):
            grbl.device.touch_towards(centre, feed_mm_per_s=5.0)
        assert stands_still(grbl)

    def test_doubled_probe_result_is_an_error(self, grbl: Rig) -> None:
        centre = grbl.before()
        grbl.line.once(b"[PRB", lambda line: line + line)
        with pytest.raises(ProtocolError, match="2 probe results"):
            grbl.device.touch_towards(centre, feed_mm_per_s=5.0)

    def test_lost_probe_result_is_an_error(self, grbl: Rig) -> None:
        centre = grbl.before()
        grbl.line.once(b"[PRB", lambda _: b"")
        with pytest.raises(ProtocolError, match="0 probe results"):
            grbl.device.touch_towards(centre, feed_mm_per_s=5.0)

    def test_latch_beside_the_path_is_an_error(self, grbl: Rig) -> None:
        centre = grbl.before()
        grbl.line.once(b"[PRB", lambda _: b"[PRB:-1.000,-2.000,-3.000:1]\r\n")
        with pytest.raises(ProtocolError, match="off the commanded path"):
            grbl.device.touch_towards(centre, feed_mm_per_s=5.0)

    def test_late_answer_to_a_previous_user_is_discarded(self, tmp_path: Path) -> None:
        with rig(tmp_path) as grbl:
            grbl.type(b"G1X-39")  # another program died in the middle of a line
            grbl.line.once(b"error", lambda line: b"ok\r\nok\r\n" + line)
            grbl.device.open()
            assert grbl.device.position() == pytest.approx([0.0, 0.0, 0.0])
            assert grbl.device.status().state is MotionState.IDLE

    def test_dead_peer_is_a_timeout_and_a_hold_is_sent_nevertheless(self, grbl: Rig) -> None:
        grbl.at(3.0, grbl.line.dead)
        with pytest.raises(LinkTimeout) as caught:
            go_far(grbl)
        assert any("feed hold was sent" in note for note in caught.value.__notes__)
        assert stands_still(grbl)

    def test_vanished_port_is_a_lost_link(self, grbl: Rig) -> None:
        grbl.at(3.0, grbl.port.close)
        with pytest.raises(LinkLost, match="gone"):
            go_far(grbl)

    def test_absent_port(self, tmp_path: Path) -> None:
        with rig(tmp_path, port=str(tmp_path / "ttyNone")) as grbl, pytest.raises(LinkLost, match="cannot be opened"):
            grbl.device.open()

    def test_silent_peer(self, tmp_path: Path) -> None:
        with rig(tmp_path) as grbl:
            grbl.line.dead()
            with pytest.raises(LinkTimeout, match="no status report"):
                grbl.device.open()

    def test_peer_that_is_not_a_grbl(self, tmp_path: Path) -> None:
        with rig(tmp_path) as grbl:
            grbl.line.on_line = lambda _: b"login: \r\n"
            with pytest.raises(ProtocolError, match="is not a GRBL controller"):
                grbl.device.open()

    def test_two_masters_are_refused(self, grbl: Rig, tmp_path: Path) -> None:
        other = SerialCnc(grbl.device._settings, DeviceContext("second", grbl.clock, tmp_path))
        with pytest.raises(LinkLost, match="cannot be opened"):
            other.open()

    def test_idle_report_before_the_motion_has_begun_is_not_its_end(self, grbl: Rig) -> None:
        """`ok` means only that the motion is planned; the controller may still report idle for a moment."""
        grbl.line.once(b"<Run", lambda line: line.replace(b"<Run", b"<Idle"))
        go_far(grbl)
        assert grbl.device.position() == pytest.approx(FAR)
        assert grbl.clock.now() > 20.0

    def test_never_more_sent_than_the_receive_buffer_holds(self, grbl: Rig) -> None:
        grbl.device.close()
        settings = SerialCncSettings(port=grbl.port.line.device_path, response_timeout_s=1.0)
        conversation = Conversation(SerialPort(SerialAddress(settings.port, settings.baud)), settings)
        conversation.open()
        conversation.synchronise()
        sent = [conversation.send("G53G1X-3990F60")]
        with pytest.raises(LinkTimeout, match="buffer is full"):
            for _ in range(40):  # the dwell waits for the motion, and no time passes
                sent.append(conversation.send("G4P0"))
        unanswered = [ticket for ticket in sent if not ticket.answered]
        assert 100 < sum(len(ticket.line) + 1 for ticket in unanswered) < 128
        conversation.close()


class TestTheControllerIntervenes:
    def test_reboot_in_motion_is_a_fault_and_loses_the_position(self, grbl: Rig) -> None:
        grbl.at(3.0, grbl.port.controller.reboot)
        with pytest.raises(MotionFault, match="restarted in the middle of a move"):
            go_far(grbl)
        assert stands_still(grbl)
        status = grbl.device.status()
        assert status.state is MotionState.FAULT
        assert Permission.REFERENCED in status.missing
        with pytest.raises(CommandRejected, match="home the machine"):
            grbl.device.reset()

    def test_reboot_of_a_machine_that_cannot_home_is_detected(self, tmp_path: Path) -> None:
        with rig(tmp_path, settings={22: 0}, manual_referencing=True) as grbl:
            grbl.device.open()
            assert not grbl.device.status().missing
            grbl.port.controller.reboot()
            assert grbl.device.status().missing == (Permission.REFERENCED,)

    def test_reset_button_in_motion_is_alarm_3(self, grbl: Rig) -> None:
        grbl.at(3.0, lambda: grbl.type(b"\x18"))
        with pytest.raises(MotionFault, match="restarted"):
            go_far(grbl)
        assert "reset in motion" in grbl.device.status().fault
        with pytest.raises(PermissionMissing, match="referenced"):
            go_far(grbl)

    def test_feed_hold_at_the_machine_is_waited_for(self, grbl: Rig) -> None:
        grbl.at(3.0, lambda: grbl.type(b"!"))
        grbl.at(40.0, lambda: grbl.type(b"~"))
        go_far(grbl)
        assert grbl.device.position() == pytest.approx(FAR)
        assert grbl.clock.now() > 50.0

    def test_hold_between_two_motions_is_waited_for(self, grbl: Rig) -> None:
        grbl.type(b"!")
        grbl.at(20.0, lambda: grbl.type(b"~"))
        go_far(grbl)
        assert grbl.clock.now() > 20.0
        assert grbl.device.position() == pytest.approx(FAR)

    def test_hold_between_two_motions_that_is_never_released_ends(self, tmp_path: Path) -> None:
        with rig(tmp_path, max_hold_s=30.0) as grbl:
            grbl.device.open()
            grbl.type(b"!")
            with pytest.raises(MotionFault, match="held at the machine for more than 30 s"):
                go_far(grbl)
            assert grbl.world.controller.displayed_position()[0] == 0.0

    def test_hold_that_is_never_released_ends(self, tmp_path: Path) -> None:
        with rig(tmp_path, max_hold_s=30.0) as grbl:
            grbl.device.open()
            grbl.at(3.0, lambda: grbl.type(b"!"))
            with pytest.raises(MotionFault, match="held at the machine for more than 30 s"):
                go_far(grbl)
            assert grbl.device.status().state is MotionState.IDLE

    def test_door_in_motion_is_a_missing_permission(self, grbl: Rig) -> None:
        def open_door() -> None:
            grbl.world.controller.granted[Permission.DOORS_CLOSED] = False

        grbl.at(3.0, open_door)
        with pytest.raises(PermissionMissing, match="door was opened"):
            go_far(grbl)
        assert stands_still(grbl)
        assert Permission.DOORS_CLOSED in grbl.device.status().missing
        grbl.world.controller.granted[Permission.DOORS_CLOSED] = True
        with pytest.raises(CommandRejected, match="Door:0"):
            go_far(grbl)
        grbl.device.reset()
        go_far(grbl)

    def test_hold_and_resume_from_here(self, grbl: Rig) -> None:
        seen: list[MotionState] = []
        grbl.at(3.0, grbl.device.hold)
        grbl.at(5.0, lambda: seen.append(grbl.device.status().state))
        grbl.at(6.0, grbl.device.resume)
        go_far(grbl)
        assert seen == [MotionState.HELD]
        assert grbl.device.position() == pytest.approx(FAR)

    def test_stop_keeps_the_position_and_discards_the_motion(self, grbl: Rig) -> None:
        grbl.at(3.0, grbl.device.stop)
        with pytest.raises(MotionFault, match="move was stopped"):
            go_far(grbl)
        assert grbl.clock.now() < 4.0
        grbl.clock.sleep(1.0)
        assert grbl.device.status().state is MotionState.IDLE
        assert not grbl.device.status().missing
        assert 50.0 < grbl.device.position()[0] < 200.0
        grbl.type(b"~")
        assert stands_still(grbl)
        go_far(grbl)

    def test_stop_in_a_touch_leaves_nothing_behind(self, grbl: Rig) -> None:
        centre = grbl.before()
        grbl.at(grbl.clock.now() + 0.5, grbl.device.stop)
        with pytest.raises(MotionFault, match="touch was stopped"):
            grbl.device.touch_towards(centre, feed_mm_per_s=5.0)
        grbl.clock.sleep(1.0)
        assert grbl.device.status().state is MotionState.IDLE
        assert isinstance(grbl.device.touch_towards(centre, feed_mm_per_s=5.0), Touch)

    @pytest.mark.parametrize("guarded", [False, True])
    def test_soft_limit_of_the_controller_silences_it_and_is_reset(self, grbl: Rig, guarded: bool) -> None:
        grbl.port.controller.settings.store(130, 3500.0)  # fewer than when the device was opened
        with pytest.raises(MotionFault, match="outside the travel"):
            grbl.device.move_to(np.array([100.0, 0.0, 0.0]), feed_mm_per_s=50.0, guarded=guarded)
        status = grbl.device.status()
        assert (status.state, "alarm 2" in status.fault) == (MotionState.FAULT, True)
        grbl.device.reset()
        assert not grbl.device.status().missing
        grbl.device.move_to(np.array([600.0, 0.0, 0.0]), feed_mm_per_s=50.0, guarded=guarded)

    def test_collision_ends_in_a_fault_that_needs_homing(self, grbl: Rig) -> None:
        centre = grbl.before()
        with pytest.raises(MotionFault, match="limit switch"):
            grbl.device.move_to(centre, feed_mm_per_s=100.0, guarded=False)
        assert grbl.device.status().state is MotionState.FAULT
        with pytest.raises(CommandRejected, match="home"):
            grbl.device.reset()

    def test_spindle_that_turns_is_a_missing_permission(self, grbl: Rig) -> None:
        grbl.type(b"M3S1000\n")
        with pytest.raises(ProtocolError, match="no line waits"):
            grbl.device.status()
        assert Permission.SPINDLE_STOPPED in grbl.device.status().missing
        with pytest.raises(PermissionMissing, match="spindle"):
            go_far(grbl)

    def test_locked_controller_can_be_read_but_not_moved(self, tmp_path: Path) -> None:
        with rig(tmp_path, homed=False) as grbl:
            grbl.device.open()
            status = grbl.device.status()
            assert status.state is MotionState.FAULT
            assert "not homed" in status.fault
            with pytest.raises(PermissionMissing):
                go_far(grbl)
            with pytest.raises(CommandRejected):
                grbl.device.reset()

    @pytest.mark.parametrize("code", [6, 8, 9])
    def test_failed_homing_says_home_the_machine(self, grbl: Rig, code: int) -> None:
        grbl.line.on_line = lambda line: b"" if line == b"ok\r\n" else line
        grbl.port.controller.homing_fails = code
        grbl.type(b"$H\n")
        grbl.line.on_line = None
        assert f"alarm {code}" in grbl.device.status().fault
        with pytest.raises(PermissionMissing, match=r"homing.*home the machine \(\$H\)"):
            go_far(grbl)
        with pytest.raises(CommandRejected, match=r"home the machine \(\$H\)"):
            grbl.device.reset()

    def test_homing_brings_the_axes_to_their_switches_and_ends_a_lock(self, tmp_path: Path) -> None:
        with rig(tmp_path, homed=False, settings=FAST_HOMING) as grbl:
            grbl.device.open()
            assert Permission.NO_FAULT in grbl.device.status().missing
            assert grbl.device.why_no_homing() == ""
            assert grbl.device.homing_directions() == (1, 1, 1)
            grbl.device.home_axes()
            assert not grbl.device.status().missing
            upper = np.array(grbl.device.limits().upper_mm)
            assert grbl.device.position() == pytest.approx(upper - 1.0, abs=1e-3)
            go_far(grbl)
            grbl.device.home_axes()  # axes that are homed already
            assert grbl.device.position() == pytest.approx(upper - 1.0, abs=1e-3)

    @pytest.mark.parametrize("dialect", [GRBL_11, GRBL_HAL])
    @pytest.mark.parametrize("code", [6, 8, 9])
    def test_homing_that_fails_is_a_fault_and_the_position_is_lost(
        self, tmp_path: Path, code: int, dialect: GrblDialect
    ) -> None:
        with rig(tmp_path, dialect=dialect, settings=FAST_HOMING) as grbl:
            grbl.device.open()
            grbl.port.controller.homing_fails = code
            with pytest.raises(MotionFault, match=rf"homing failed: .*alarm {code}"):
                grbl.device.home_axes()
            assert Permission.REFERENCED in grbl.device.status().missing
            grbl.port.controller.homing_fails = None
            grbl.device.home_axes()
            assert not grbl.device.status().missing

    def test_a_homing_that_is_interrupted_is_ended_and_the_position_is_lost(self, tmp_path: Path) -> None:
        class AbortedError(Exception):
            pass

        with rig(tmp_path, settings=FAST_HOMING) as grbl:
            grbl.device.open()

            def abort() -> None:
                assert grbl.world.controller.motion is MotionState.MOVING
                raise AbortedError

            grbl.at(grbl.clock.now() + 5.0, abort)
            with pytest.raises(AbortedError):
                grbl.device.home_axes()
            status = grbl.device.status()
            assert stands_still(grbl)
            assert status.state is MotionState.FAULT
            assert Permission.REFERENCED in status.missing
            grbl.device.home_axes()
            assert not grbl.device.status().missing

    def test_homing_that_does_not_end_in_time_is_ended(self, tmp_path: Path) -> None:
        with rig(tmp_path, homing_timeout_s=5.0) as grbl:
            grbl.device.open()
            with pytest.raises(DeadlineExpired, match="end of homing"):
                grbl.device.home_axes()
            assert grbl.device.status().state is MotionState.FAULT
            assert stands_still(grbl)

    def test_homing_is_refused_with_the_door_open_and_in_a_motion(self, grbl: Rig) -> None:
        grbl.world.controller.granted[Permission.DOORS_CLOSED] = False
        with pytest.raises(CommandRejected, match="door is open"):
            grbl.device.home_axes()
        grbl.world.controller.granted[Permission.DOORS_CLOSED] = True
        grbl.type(b"~")
        grbl.line.on_line = lambda line: b"" if line == b"ok\r\n" else line  # of the line of another user
        grbl.type(b"G53G1X-3990F600\n")
        grbl.line.on_line = None
        with pytest.raises(CommandRejected, match="not idle: Run"):
            grbl.device.home_axes()

    def test_homing_is_refused_where_it_is_off(self, tmp_path: Path) -> None:
        with rig(tmp_path, settings={22: 0, 23: 5}, manual_referencing=True) as grbl:
            grbl.device.open()
            assert grbl.device.homing_directions() == (-1, 1, -1)
            assert grbl.device.why_no_homing() == "$22=0: homing is off in the controller"
            with pytest.raises(CommandRejected, match=r"\$22=0: homing is off"):
                grbl.device.home_axes()

    def test_homing_that_is_off_says_what_to_set(self, tmp_path: Path) -> None:
        with rig(tmp_path, settings={22: 0}) as grbl:
            grbl.device.open()
            with pytest.raises(PermissionMissing, match=r"\$22=1.*manual_referencing"):
                go_far(grbl)

    def test_controller_that_runs_something_is_left_alone(self, tmp_path: Path) -> None:
        with rig(tmp_path) as grbl:
            grbl.type(b"G1X-100F600\n")
            with pytest.raises(CommandRejected, match="state Run"):
                grbl.device.open()
            assert grbl.world.controller.motion is MotionState.MOVING

    def test_motion_of_a_program_that_died_may_end_first(self, tmp_path: Path) -> None:
        with rig(tmp_path) as grbl:
            grbl.type(b"G38.3X-3900F600\n")
            grbl.device.open()
            assert grbl.device.position() == pytest.approx([100.0, 0.0, 0.0])
            grbl.device.touch_towards(np.array([110.0, 0.0, 0.0]), feed_mm_per_s=10.0)

    def test_held_controller_is_left_alone(self, tmp_path: Path) -> None:
        with rig(tmp_path) as grbl:
            grbl.type(b"!")
            with pytest.raises(CommandRejected, match="state Hold"):
                grbl.device.open()


class TestGrblHal:
    @pytest.fixture
    def hal(self, tmp_path: Path) -> Iterator[Rig]:
        with rig(tmp_path, dialect=GRBL_HAL) as made:
            made.device.open()
            yield made

    def test_is_driven_like_grbl(self, tmp_path: Path) -> None:
        with rig(tmp_path, dialect=GRBL_HAL) as grbl:
            assert all(finding.ok for finding in grbl.device.diagnose())
            grbl.device.open()
            centre = grbl.before()
            assert isinstance(grbl.device.touch_towards(centre, feed_mm_per_s=5.0), Touch)
            grbl.device.stop()
            grbl.device.move_to(centre - np.array([0.0, 25.0, 0.0]), feed_mm_per_s=None, guarded=True)

    def test_reports_why_it_is_locked(self, tmp_path: Path) -> None:
        with rig(tmp_path, homed=False, dialect=GRBL_HAL) as grbl:
            grbl.line.on_line = lambda line: line.replace(b"<Alarm|", b"<Alarm:11|")
            grbl.device.open()
            assert "homing required (alarm 11)" in grbl.device.status().fault
            with pytest.raises(CommandRejected, match="home the machine"):
                grbl.device.reset()

    def test_reports_that_it_is_not_homed_without_an_alarm(self, grbl: Rig) -> None:
        grbl.line.on_line = lambda line: line.replace(b"|FS:", b"|H:0|FS:")
        assert grbl.device.status().missing == (Permission.REFERENCED,)
        grbl.line.on_line = lambda line: line.replace(b"|FS:", b"|H:1,7|FS:")
        assert not grbl.device.status().missing

    def test_refused_line_is_acknowledged_so_that_the_next_is_executed(self, hal: Rig) -> None:
        hal.line.on_line = lambda line: b"" if line.startswith(b"error") else line
        hal.type(b"G99\n")  # a line of somebody else, whose error nobody has acknowledged
        hal.line.on_line = None
        with pytest.raises(CommandRejected, match="unsupported G-code"):
            go_far(hal)
        go_far(hal)
        assert hal.device.position() == pytest.approx(FAR)

    def test_error_of_an_earlier_program_is_acknowledged_at_the_start(self, tmp_path: Path) -> None:
        with rig(tmp_path, dialect=GRBL_HAL) as grbl:
            grbl.type(b"G99\n")
            grbl.device.open()
            go_far(grbl)
            assert grbl.device.position() == pytest.approx(FAR)

    def test_hard_limits_shrink_the_travel(self, tmp_path: Path) -> None:
        with rig(tmp_path, dialect=GRBL_HAL, settings={21: 1, 27: 2.5}) as grbl:
            grbl.device.open()
            limits = grbl.device.limits()
            assert limits.lower_mm == pytest.approx((2.5, 2.5, 2.5))
            assert limits.upper_mm == pytest.approx((3997.5, 1297.5, 1497.5))
            with pytest.raises(CommandRejected, match=r"outside the travel, 2.5 to 3997.5"):
                grbl.device.move_to(np.array([2.4, 10.0, 10.0]), feed_mm_per_s=None, guarded=False)
            grbl.device.move_to(np.array(limits.lower_mm), feed_mm_per_s=None, guarded=False)

    def test_axes_without_a_homing_cycle_keep_their_travel(self, tmp_path: Path) -> None:
        with rig(tmp_path, dialect=GRBL_HAL, settings={21: 1, 27: 2.5, 44: 1, 45: 0}) as grbl:
            grbl.device.open()
            assert grbl.device.limits().lower_mm == pytest.approx((2.5, 0.0, 0.0))


class TestTargetWhereTheAxesStand:
    """A probe cycle to the position of the controller's parser is error 33, and positions are reported rounded."""

    @pytest.mark.parametrize("dialect", [GRBL_11, GRBL_HAL], ids=lambda dialect: dialect.name)
    @pytest.mark.parametrize("first", [True, False])
    def test_guarded_move_is_no_move(self, tmp_path: Path, dialect: GrblDialect, first: bool) -> None:
        with rig(tmp_path, dialect=dialect) as grbl:
            grbl.device.open()
            target = np.array([10.0004, 0.0004, 20.0003])
            grbl.device.move_to(target, feed_mm_per_s=None, guarded=first)
            grbl.device.move_to(target, feed_mm_per_s=None, guarded=True)
            assert isinstance(grbl.device.touch_towards(target, feed_mm_per_s=1.0), Miss)
            assert grbl.device.position() == pytest.approx(target, abs=1.1e-3)
            assert not [line for line in grbl.line.said if line.startswith(b"error:33")]

    def test_target_between_two_steps(self, grbl: Rig) -> None:
        target = np.array([10.0005, 0.0005, 20.0005])
        for _ in range(3):
            grbl.device.move_to(target, feed_mm_per_s=None, guarded=True)
            assert grbl.device.position() == pytest.approx(target, abs=1.1e-3)

    def test_coarse_steps(self, tmp_path: Path) -> None:
        with rig(tmp_path, settings={100: 80, 101: 80, 102: 80}) as grbl:
            grbl.device.open()
            for offset in np.linspace(0.0, 0.0124, 6):
                target = np.array([10.0, 5.0, 20.0]) + offset
                grbl.device.move_to(target, feed_mm_per_s=None, guarded=True)
                assert grbl.device.position() == pytest.approx(target, abs=0.0068)

    def test_refusal_because_it_stands_there_is_no_error(self, grbl: Rig) -> None:
        """The controller may know the position better than its report shows."""
        target = np.array([10.0, 5.0, 20.0])
        grbl.device.move_to(target, feed_mm_per_s=None, guarded=False)
        grbl.line.on_line = lambda line: line.replace(b"MPos:-3990.000", b"MPos:-3990.005")
        grbl.device.move_to(target, feed_mm_per_s=None, guarded=True)
        assert [line for line in grbl.line.said if line.startswith(b"error:33")]

    def test_refusal_far_from_the_target_is_an_error(self, grbl: Rig) -> None:
        target = np.array([10.0, 5.0, 20.0])
        grbl.device.move_to(target, feed_mm_per_s=None, guarded=False)
        grbl.line.on_line = lambda line: line.replace(b"MPos:-3990.000", b"MPos:-3991.000")
        with pytest.raises(CommandRejected, match="error 33"):
            grbl.device.move_to(target, feed_mm_per_s=None, guarded=True)


class TestLateAnswers:
    """A lost answer is decided by time, and a report of an earlier query is never taken for a new one."""

    def test_answer_that_is_late_is_not_lost(self, tmp_path: Path) -> None:
        with rig(tmp_path, response_timeout_s=2.0) as grbl:
            grbl.device.open()
            kept: list[bytes] = []

            def keep(line: bytes) -> bytes:
                kept.append(line)
                grbl.at(grbl.clock.now() + 1.5, lambda: grbl.port.line.send(kept[0]))
                return b""

            grbl.at(5.0, lambda: grbl.line.once(b"ok", keep))
            go_far(grbl)
            assert kept == [b"ok\r\n"]
            assert grbl.device.position() == pytest.approx(FAR)

    def test_report_that_comes_after_the_repetition_is_not_taken_for_the_next(self, tmp_path: Path) -> None:
        with rig(tmp_path) as grbl:
            grbl.device.open()
            late = DelayedReports(grbl, by_s=0.35)  # a repetition is sent after 0.3 s
            grbl.device.status()
            late.at_once()
            go_far(grbl)
            assert grbl.device.position() == pytest.approx(FAR)

    def test_report_of_a_query_that_timed_out_is_not_taken_for_the_next(self, tmp_path: Path) -> None:
        with rig(tmp_path) as grbl:
            grbl.device.open()
            kept: list[bytes] = []

            def keep(line: bytes) -> bytes:
                kept.append(line)
                return b""

            grbl.line.on_line = keep
            with pytest.raises(LinkTimeout):
                grbl.device.position()
            grbl.line.on_line = None
            for old in kept:
                grbl.port.line.send(old.replace(b"-4000.000", b"-3000.000"))
            assert len(kept) == 3
            assert grbl.device.position() == pytest.approx([0.0, 0.0, 0.0])


class DelayedReports:
    """Line on which every status report comes `by_s` of wall time late."""

    def __init__(self, grbl: Rig, by_s: float) -> None:
        self._grbl, self._by_s = grbl, by_s
        self._timers: list[threading.Timer] = []
        grbl.line.on_line = self._delay

    def _delay(self, line: bytes) -> bytes:
        if not line.startswith(b"<"):
            return line
        timer = threading.Timer(self._by_s, lambda: os.write(self._grbl.port.line._ours, line))
        self._timers.append(timer)
        timer.start()
        return b""

    def at_once(self) -> None:
        self._grbl.line.on_line = None


class TestRunningClock:
    def test_moves_touches_and_stops(self, tmp_path: Path) -> None:
        """The driver must also work on a clock that runs while the program computes."""
        clock = ScaledClock(40.0)
        with rig(tmp_path, clock=clock) as grbl:
            ticker = Ticker(grbl.shared, clock)
            ticker.start()
            grbl.device.open()
            centre = grbl.before()
            touch = grbl.device.touch_towards(centre, feed_mm_per_s=5.0)
            assert isinstance(touch, Touch)
            assert touch.position_mm[1] == pytest.approx(centre[1] - 15.5, abs=1.1e-3)
            grbl.device.move_to(centre - np.array([0.0, 25.0, 0.0]), feed_mm_per_s=None, guarded=True)
            grbl.device.stop()
            grbl.device.move_to(np.array([centre[0], 0.0, 750.0]), feed_mm_per_s=200.0, guarded=True)
            assert not grbl.device.status().missing
            ticker.close()


class TestProbing:
    def test_alarm_that_kept_the_position_is_reset(self, grbl: Rig) -> None:
        grbl.line.on_line = lambda line: b"" if line in (b"ok\r\n",) or line.startswith(b"[PRB") else line
        grbl.type(b"G21G90G38.2X-3990F6000\n")
        grbl.clock.sleep(5.0)
        grbl.line.on_line = None
        assert "found nothing" in grbl.device.status().fault
        grbl.device.reset()
        assert not grbl.device.status().missing
        go_far(grbl)

    def test_foreign_work_offset_does_not_shift_a_touch(self, grbl: Rig) -> None:
        centre = grbl.before()
        first = grbl.device.touch_towards(centre, feed_mm_per_s=5.0)
        grbl.device.move_to(centre - [0.0, 25.0, 0.0], feed_mm_per_s=None, guarded=True)
        grbl.port.controller.offsets.systems[54] = (12.3, -45.6, 7.8)
        assert grbl.device.touch_towards(centre, feed_mm_per_s=5.0) == first

    def test_offset_of_the_start_is_read_before_the_first_touch(self, tmp_path: Path) -> None:
        with rig(tmp_path) as grbl:
            grbl.port.controller.offsets.systems[54] = (-100.0, 20.0, 3.0)
            grbl.device.open()
            centre = grbl.before()
            touch = grbl.device.touch_towards(centre, feed_mm_per_s=5.0)
            assert isinstance(touch, Touch)
            assert touch.position_mm == pytest.approx(tuple(centre - [0.0, 15.5, 0.0]), abs=1.1e-3)

    def test_inch_and_relative_modes_of_another_user_have_no_effect(self, grbl: Rig) -> None:
        grbl.line.on_line = lambda line: b"" if line == b"ok\r\n" else line
        grbl.type(b"G20G91\n")
        grbl.line.on_line = None
        grbl.device.move_to(np.array([10.0, 0.0, 0.0]), feed_mm_per_s=None, guarded=True)
        assert grbl.device.position() == pytest.approx([10.0, 0.0, 0.0])

    def test_pressing_further_is_refused(self, grbl: Rig) -> None:
        centre = grbl.before()
        grbl.device.touch_towards(centre, feed_mm_per_s=5.0)
        with pytest.raises(CommandRejected, match="press it further"):
            grbl.device.move_to(centre, feed_mm_per_s=5.0, guarded=True)

    def test_probe_that_stays_deflected_ends_the_withdrawal(self, grbl: Rig) -> None:
        centre = grbl.before()
        grbl.device.touch_towards(centre, feed_mm_per_s=5.0)
        grbl.port.controller.settings.store(6, 1.0)  # as if its wire were broken
        grbl.device.move_to(centre - [0.0, 25.0, 0.0], feed_mm_per_s=None, guarded=False)
        with pytest.raises(MotionFault, match="still deflected after 5 mm"):
            grbl.device.move_to(centre - [0.0, 100.0, 0.0], feed_mm_per_s=50.0, guarded=True)
        assert stands_still(grbl)

    def test_guarded_move_off_a_ball_guards_the_rest_of_its_path(self, grbl: Rig) -> None:
        centre = grbl.before()
        grbl.device.touch_towards(centre, feed_mm_per_s=5.0)
        here = grbl.device.position()
        with pytest.raises((GuardTripped, CommandRejected)):
            grbl.device.move_to(here + np.array([0.0, 0.001, 0.0]), feed_mm_per_s=5.0, guarded=True)
        grbl.device.move_to(here - np.array([0.0, 10.0, 0.0]), feed_mm_per_s=5.0, guarded=True)
        assert not grbl.device.probe_status().deflected


class TestDoctor:
    def test_good_machine(self, tmp_path: Path) -> None:
        with rig(tmp_path) as grbl:
            findings = grbl.device.diagnose()
            assert all(finding.ok for finding in findings)
            assert {"latency", "settings", "steps", "probe", "tables", "travel"} - {f.subject for f in findings} <= {
                "settings"
            }
            assert grbl.world.controller.motion is MotionState.IDLE

    def test_directions_and_shortened_travel_are_stated(self, tmp_path: Path) -> None:
        with rig(tmp_path, dialect=GRBL_HAL, settings={21: 1, 23: 2, 27: 2.5, 3: 4}) as grbl:
            [text] = [finding.text for finding in grbl.device.diagnose() if finding.subject == "directions"]
            assert "X upper, Y lower, Z upper" in text
            assert "$3=4" in text
            assert "Z 2.5 mm" in text

    @pytest.mark.parametrize(
        ("settings", "subject", "words"),
        [
            ({13: 1}, "settings", "$13=1"),
            ({10: 0}, "settings", "$10=0"),
            ({20: 0}, "soft limits", "$20=1"),
            ({22: 0}, "homing", "$22=0"),
            ({6: 1}, "probe", "$6"),
            ({101: 250}, "steps", "Y 4 µm"),
            ({1: 25}, "motors at rest", "$1=255"),
            ({32: 1}, "laser mode", "$32=0"),
            ({120: 0}, "settings", "must be positive"),
        ],
    )
    def test_each_wrong_setting_is_named(
        self, tmp_path: Path, settings: dict[int, float], subject: str, words: str
    ) -> None:
        with rig(tmp_path, settings=settings) as grbl:
            wrong = [finding for finding in grbl.device.diagnose() if not finding.ok]
            assert (subject, True) in [(finding.subject, words in finding.text) for finding in wrong]

    @pytest.mark.parametrize("settings", [{13: 1}, {10: 0}, {110: 0}])
    def test_settings_that_would_be_misread_are_refused(self, tmp_path: Path, settings: dict[int, float]) -> None:
        with rig(tmp_path, settings=settings) as grbl, pytest.raises(ConfigurationError, match=r"\$1"):
            grbl.device.open()

    def test_unreachable(self, tmp_path: Path) -> None:
        with rig(tmp_path) as grbl:
            grbl.line.dead()
            findings = grbl.device.diagnose()
            assert [finding.subject for finding in findings if not finding.ok] == ["link"]


class TestLook:
    def test_a_board_that_may_restart_when_its_port_is_opened_is_not_opened(self, tmp_path: Path) -> None:
        with rig(tmp_path) as grbl:
            reason = grbl.device.why_no_look()
            assert "restarts_when_opened = false" in reason
            with pytest.raises(CommandRejected, match="may restart"):
                grbl.device.open_to_look()
            assert not grbl.device._conversation.line.connected
            assert grbl.line.said == []

    def test_a_board_that_restarts_although_it_should_not_is_an_error_that_says_so(self, tmp_path: Path) -> None:
        with rig(tmp_path, restarts_when_opened=False) as grbl:
            grbl.line.once(b"<", lambda report: b"\r\nGrbl 1.1h ['$' for help]\r\n" + report)
            with pytest.raises(CommandRejected, match="restarted when its port was opened") as refused:
                grbl.device.open_to_look()
            assert "remove restarts_when_opened" in refused.value.hint
            assert not grbl.device._conversation.line.connected
            grbl.device.open_to_look()
            assert grbl.device.active_bank() == 0
