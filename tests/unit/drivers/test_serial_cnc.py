"""Tests of the serial CNC driver with a faulty GRBL: every fault gives a typed error, and the machine stops."""

from __future__ import annotations

import termios
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from serial_rig import Rig, rig

from drivers.clock import ScaledClock
from drivers.errors import (
    CommandRejected,
    ConfigurationError,
    GuardTripped,
    LinkLost,
    LinkTimeout,
    MotionFault,
    PermissionMissing,
    ProtocolError,
)
from drivers.links.serial_port import SerialAddress, SerialPort
from drivers.registry import DeviceContext
from drivers.roles import MotionState, Permission, Touch
from drivers.serial_cnc.conversation import Conversation
from drivers.serial_cnc.device import SerialCnc
from drivers.serial_cnc.settings import SerialCncSettings
from simulators.wire.time_server import Ticker

FAR = np.array([1000.0, 0.0, 0.0])


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
        with pytest.raises(ProtocolError, match="no line waits"):
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
    """Differences in grblHAL (its core's report.c): name, firmware, longer masks, alarm as a sub-state, homed."""

    @staticmethod
    def hal(line: bytes) -> bytes:
        return (
            line.replace(b"Grbl 1.1h ['$' for help]", b"GrblHAL 1.1f ['$' or '$HELP' for help]")
            .replace(b"[OPT:VL,15,128]\r\n", b"[OPT:VNMGL,100,1024,3,0]\r\n[FIRMWARE:grblHAL]\r\n")
            .replace(b"$10=1\r\n", b"$10=511\r\n")
            .replace(b"[TLO:0.000]", b"[TLO:0.000,0.000,0.000]")
            .replace(b"<Alarm|", b"<Alarm:11|")
        )

    def test_is_driven_like_grbl(self, tmp_path: Path) -> None:
        with rig(tmp_path) as grbl:
            grbl.line.on_line = self.hal
            assert all(finding.ok for finding in grbl.device.diagnose())
            grbl.device.open()
            centre = grbl.before()
            assert isinstance(grbl.device.touch_towards(centre, feed_mm_per_s=5.0), Touch)
            grbl.device.stop()
            grbl.device.move_to(centre - np.array([0.0, 25.0, 0.0]), feed_mm_per_s=None, guarded=True)

    def test_reports_why_it_is_locked(self, tmp_path: Path) -> None:
        with rig(tmp_path, homed=False) as grbl:
            grbl.line.on_line = self.hal
            grbl.device.open()
            assert "homing required (alarm 11)" in grbl.device.status().fault
            with pytest.raises(CommandRejected, match="home the machine"):
                grbl.device.reset()

    def test_reports_that_it_is_not_homed_without_an_alarm(self, grbl: Rig) -> None:
        grbl.line.on_line = lambda line: line.replace(b"|FS:", b"|H:0|FS:")
        assert grbl.device.status().missing == (Permission.REFERENCED,)
        grbl.line.on_line = lambda line: line.replace(b"|FS:", b"|H:1,7|FS:")
        assert not grbl.device.status().missing


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
