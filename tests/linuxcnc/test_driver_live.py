"""Tests of the driver with a running stock LinuxCNC, on an error-free machine with known ball positions."""

from __future__ import annotations

import os
import signal
import subprocess
import threading
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
import pytest
from live import REACH_MM, SPEED, Live, until
from requirements import requires_linuxcnc

from drivers.clock import RealClock
from drivers.errors import (
    CommandRejected,
    ConfigurationError,
    GuardTripped,
    LinkLost,
    MotionFault,
    PermissionMissing,
)
from drivers.linuxcnc.bridge_link import BridgeLink
from drivers.linuxcnc.device import LinuxCnc
from drivers.roles import (
    CompensationStore,
    Machine,
    Miss,
    MotionState,
    Permission,
    Probe,
    TableImage,
    Thermometer,
    Touch,
)
from simulators.linuxcnc.namespaces import first_child

FEED = 5.0
CYCLE_MM = FEED * 1e-3
"""Travel in one servo cycle at that feed."""
AWAY = np.array([3000.0, 100.0, 200.0])

pytestmark = [
    requires_linuxcnc,
]


@pytest.fixture
def device(live: Live) -> Iterator[LinuxCnc]:
    with live.opened() as opened:
        yield opened


def before(live: Live, device: LinuxCnc, distance_mm: float = 20.0) -> np.ndarray:
    """Move the tip in front of ball 5, on its -Y side, and return the ball's axis position."""
    ball = live.balls[5]
    here = device.position()
    device.move_to(np.array([here[0], 0.0, here[2]]), feed_mm_per_s=None, guarded=True)
    device.move_to(np.array([ball[0], 0.0, ball[2]]), feed_mm_per_s=None, guarded=True)
    device.move_to(ball - [0.0, distance_mm, 0.0], feed_mm_per_s=None, guarded=True)
    return ball


@contextmanager
def bouncing(live: Live, bounce_s: float) -> Iterator[None]:
    """Let the contact of the probe open in every other servo cycle for this time after each trip."""
    try:
        set_bounce(live, bounce_s)
        yield
    finally:
        set_bounce(live, 0.0)


def set_bounce(live: Live, bounce_s: float) -> None:
    words = live.process.inside("halcmd", "setp", "volcal-plant.bounce-s", f"{bounce_s}")
    subprocess.run(words, check=True, capture_output=True)


def touch(device: LinuxCnc, target: np.ndarray, feed: float = FEED) -> np.ndarray:
    result = device.touch_towards(target, feed_mm_per_s=feed)
    assert isinstance(result, Touch)
    return np.array(result.position_mm)


def test_roles_limits_and_temperatures(live: Live) -> None:
    with live.opened(temperatures={"artefact": "volcal-plant.temperature-0"}, machine_name="case-study") as device:
        assert isinstance(device, Machine)
        assert isinstance(device, Probe)
        assert isinstance(device, CompensationStore)
        assert isinstance(device, Thermometer)
        limits = device.limits()
        assert (limits.lower_mm, limits.upper_mm) == ((-1.0, -1.0, -1.0), (4001.0, 1301.0, 1501.0))
        assert limits.rapid_mm_per_s == pytest.approx((333.3,) * 3)
        assert device.temperatures_c() == {"artefact": 20.0}
        assert all(device.status().permissions.values())


def test_another_machine_is_refused(live: Live) -> None:
    device = live.device(machine_name="the other one")
    with pytest.raises(ConfigurationError, match="case-study"):
        device.open()


class TestMotion:
    def test_moves_reach_their_machine_position_with_any_active_offsets(self, live: Live, device: LinuxCnc) -> None:
        target = np.array([2900.123456, 10.5, 220.25])
        with live.bystander() as other:
            mdi(other, "G10 L2 P1 X5 Y-6 Z7", "G92 X1", "G43.1 Z3", "G20", "G91")
            device.move_to(target, feed_mm_per_s=100.0, guarded=False)
            assert device.position() == pytest.approx(target, abs=1e-6)
            device.move_to(AWAY, feed_mm_per_s=None, guarded=True)
            assert device.position() == pytest.approx(AWAY, abs=1e-6)
            miss = device.touch_towards(AWAY + np.array([0.0, 0.5, 0.0]), feed_mm_per_s=FEED)
            assert isinstance(miss, Miss)
            assert miss.position_mm == pytest.approx(tuple(AWAY + np.array([0.0, 0.5, 0.0])), abs=1e-6)
            device.close()
            modal = other.ask("status")["modal"]
            assert {20.0, 91.0} <= set(modal)
            mdi(other, "G21 G90", "G10 L2 P1 X0 Y0 Z0", "G92.1", "G49")

    def test_rotated_coordinates_are_refused(self, live: Live, device: LinuxCnc) -> None:
        with live.bystander() as other:
            mdi(other, "G10 L2 P1 R10")
            with pytest.raises(CommandRejected, match="rotated by 10"):
                device.move_to(AWAY, feed_mm_per_s=None, guarded=True)
            mdi(other, "G10 L2 P1 R0")

    @pytest.mark.parametrize("target", [(4001.1, 0.0, 0.0), (0.0, -1.1, 0.0), (np.nan, 0.0, 0.0)])
    def test_impossible_target_is_rejected_and_nothing_moves(self, device: LinuxCnc, target) -> None:
        here = device.position()
        with pytest.raises(CommandRejected):
            device.move_to(np.array(target), feed_mm_per_s=None, guarded=False)
        assert np.array_equal(device.position(), here)

    def test_hold_stops_the_motion_and_resume_completes_it(self, live: Live, device: LinuxCnc) -> None:
        device.move_to(AWAY, feed_mm_per_s=None, guarded=True)
        target = AWAY + np.array([300.0, 0.0, 0.0])
        moving = threading.Thread(
            target=device.move_to, args=(target,), kwargs={"feed_mm_per_s": 10.0, "guarded": True}
        )
        moving.start()
        until(lambda: device.position()[0] > AWAY[0] + 10.0)
        device.hold()
        until(lambda: device.status().state is MotionState.HELD)
        pause()
        held = device.position()
        pause()
        assert np.array_equal(device.position(), held)
        assert held[0] < target[0] - 50.0
        device.resume()
        moving.join(timeout=600.0)
        assert not moving.is_alive()
        assert device.position() == pytest.approx(target, abs=1e-6)

    def test_interrupted_wait_stops_the_motion(self, live: Live) -> None:
        class InterruptedWaitError(Exception):
            pass

        looks = iter(range(10**9))

        def check() -> None:
            if next(looks) > 30:
                raise InterruptedWaitError

        with live.opened(interrupt=check) as device:
            here = device.position()
            with pytest.raises(InterruptedWaitError):
                device.move_to(np.array([100.0, here[1], here[2]]), feed_mm_per_s=50.0, guarded=False)
            until(lambda: device.status().state is MotionState.IDLE)
            stopped = device.position()
            assert stopped[0] > 200.0
            pause()
            assert np.array_equal(device.position(), stopped)


class TestProbe:
    def test_the_latch_is_corrected_for_the_cycle_in_which_it_is_made(self, live: Live, device: LinuxCnc) -> None:
        """Without the correction, each latch would be 0 to 5 µm too far; the phase differs for each start."""
        ball = before(live, device)
        errors = []
        for number in range(10):
            start = ball - [0.0, 17.0 + 0.00137 * number, 0.0]
            device.move_to(start, feed_mm_per_s=None, guarded=True)
            errors.append(touch(device, ball)[1] - (ball[1] - REACH_MM))
            device.move_to(ball - [0.0, 20.0, 0.0], feed_mm_per_s=None, guarded=True)
        assert np.abs(errors).max() <= 0.5 * CYCLE_MM + 1e-4
        assert abs(np.mean(errors)) < 0.3 * CYCLE_MM
        assert np.ptp(errors) > 0.3 * CYCLE_MM

    @pytest.mark.parametrize("bounce_s", [0.0, 0.002, 0.01, 0.05])
    def test_contact_that_bounces_while_the_axes_brake(self, live: Live, device: LinuxCnc, bounce_s: float) -> None:
        """The axes brake from 30 mm/s in 60 ms. The first edge is the one that counts."""
        ball, feed = before(live, device), 30.0
        with bouncing(live, bounce_s):
            for number in range(4):
                device.move_to(ball - [0.0, 17.0 + 0.00137 * number, 0.0], feed_mm_per_s=None, guarded=True)
                error = touch(device, ball, feed=feed)[1] - (ball[1] - REACH_MM)
                assert abs(error) <= 0.5 * feed * 1e-3 + 1e-4
                until(lambda: device.probe_status().deflected)
                device.move_to(ball - [0.0, 20.0, 0.0], feed_mm_per_s=None, guarded=True)

    def test_the_simulated_contact_bounces(self, live: Live, device: LinuxCnc) -> None:
        ball = before(live, device)
        with bouncing(live, 1e6):
            touch(device, ball)
            until(lambda: not device.probe_status().deflected)
            until(lambda: device.probe_status().deflected)
        until(lambda: device.probe_status().deflected)
        device.move_to(ball - [0.0, 20.0, 0.0], feed_mm_per_s=None, guarded=True)

    def test_touch_is_displayed_without_the_correction(self, live: Live) -> None:
        """The table adds 0.2 mm in Y, so the displayed Y is 0.2 mm smaller when the tip touches the ball."""
        options = {"compensation": {"method": "external-offsets", "directory": "tables"}}
        with live.opened(**options) as device:
            ball = before(live, device)
            counts = np.zeros((2, 2, 2, 3), dtype=np.int32)
            counts[..., 1] = 2000
            device.stage(1, TableImage((0.0, 0.0, 0.0), (4000.0, 1300.0, 1500.0), 1e-4, counts))
            device.activate(1)
            try:
                assert device.position() == pytest.approx(ball - [0.0, 20.0, 0.0], abs=1e-5)
                latched = touch(device, ball, feed=1.0)
                assert latched[1] == pytest.approx(ball[1] - REACH_MM - 0.2, abs=6e-4)
                assert latched[[0, 2]] == pytest.approx(ball[[0, 2]], abs=1e-5)
                device.move_to(ball - [0.0, 20.0, 0.0], feed_mm_per_s=None, guarded=True)
            finally:
                device.activate(0)

    def test_deflected_probe_neither_touches_nor_guards_until_withdrawn(self, live: Live, device: LinuxCnc) -> None:
        ball = before(live, device)
        touch(device, ball)
        assert device.probe_status().deflected
        with pytest.raises(CommandRejected, match="deflected"):
            device.touch_towards(ball, feed_mm_per_s=FEED)
        with pytest.raises(CommandRejected, match="deflected"):
            device.move_to(ball, feed_mm_per_s=FEED, guarded=True)
        device.move_to(ball - [0.0, 20.0, 0.0], feed_mm_per_s=None, guarded=True)
        assert not device.probe_status().deflected

    def test_guarded_move_into_a_ball_stops_and_can_be_withdrawn(self, live: Live, device: LinuxCnc) -> None:
        ball = before(live, device)
        with pytest.raises(GuardTripped):
            device.move_to(ball, feed_mm_per_s=10.0, guarded=True)
        assert ball[1] - REACH_MM < device.position()[1] < ball[1] - REACH_MM + 1.0
        device.move_to(ball - [0.0, 20.0, 0.0], feed_mm_per_s=None, guarded=True)

    def test_without_the_probe_in_the_spindle_nothing_is_touched(self, live: Live) -> None:
        with live.opened(probe_tool=7) as device:
            assert not device.probe_status().loaded
            with pytest.raises(PermissionMissing, match="tool 0"):
                device.touch_towards(AWAY, feed_mm_per_s=FEED)


class TestFaults:
    def test_dead_bridge_is_a_lost_link_and_the_machine_stops(self, live: Live, device: LinuxCnc) -> None:
        start_away(device)
        bridge = first_child(device.bridge_pid or 0) or 0  # the bridge is a child of nsenter
        killer = threading.Timer(0.4, os.kill, (bridge, signal.SIGKILL))
        killer.start()
        with pytest.raises(LinkLost, match="bridge"):
            device.move_to(np.array([100.0, 100.0, 200.0]), feed_mm_per_s=100.0, guarded=True)
        until(lambda: device.status().state is MotionState.IDLE)
        stopped = device.position()
        assert stopped[0] > 200.0
        pause()
        assert np.array_equal(device.position(), stopped)

    def test_motion_without_status_queries_is_stopped_by_the_bridge(self, live: Live, device: LinuxCnc) -> None:
        start_away(device)
        with live.bystander(watchdog_timeout_s=0.3) as other:
            other.ask("mdi", line="G21 G90 G53 G1 X100 F6000")
            until(lambda: device.status().state is MotionState.IDLE)
            assert device.position()[0] > 200.0
            assert other.ask("status")["abandoned"]

    def test_motion_stops_when_the_driver_ends(self, live: Live, device: LinuxCnc) -> None:
        start_away(device)
        with live.bystander() as other:
            other.ask("mdi", line="G21 G90 G53 G1 X100 F6000")
        until(lambda: device.status().state is MotionState.IDLE)
        assert device.position()[0] > 200.0

    def test_emergency_stop_is_a_fault_that_reset_does_not_override(self, live: Live, device: LinuxCnc) -> None:
        start_away(device)
        stopping = threading.Timer(0.4, live.by_hand, ("state(linuxcnc.STATE_ESTOP)",))
        stopping.start()
        try:
            with pytest.raises((MotionFault, PermissionMissing)):
                device.move_to(np.array([100.0, 100.0, 200.0]), feed_mm_per_s=50.0, guarded=True)
            stopping.join()
            status = device.status()
            assert status.state is MotionState.FAULT
            assert "emergency stop" in status.fault
            assert Permission.NO_FAULT in status.missing
            with pytest.raises(CommandRejected, match="emergency stop"):
                device.reset()
        finally:
            live.by_hand("state(linuxcnc.STATE_ESTOP_RESET)")
        until(lambda: "emergency stop" not in device.status().fault)
        device.reset()
        assert device.status().state is MotionState.IDLE
        device.reset()

    def test_unhomed_joints_do_not_move_unless_homing_is_allowed(self, live: Live) -> None:
        with live.opened() as device:
            here = device.position()
            live.by_hand("mode(linuxcnc.MODE_MANUAL)", "teleop_enable(0)", "unhome(-1)")
            assert Permission.REFERENCED in device.status().missing
            with pytest.raises(PermissionMissing, match="homed"):
                device.move_to(AWAY, feed_mm_per_s=None, guarded=True)
            assert "not homed" in {finding.subject: finding.text for finding in device.diagnose()}["state"]
        with live.opened(homing="absolute-encoders") as device:
            assert not device.status().missing
            assert device.position() == pytest.approx(here, abs=1e-6)
            live.by_hand("mode(linuxcnc.MODE_MANUAL)", "teleop_enable(0)", "unhome(-1)")
            device.home_axes()
            assert not device.status().missing
            device.home_axes()  # of joints that are homed already
            assert not device.status().missing
            assert device.position() == pytest.approx(here, abs=1e-6)
            assert device.homing_directions() == (0, 0, 0)
            assert "absolute encoder" in device.why_no_homing()

    def test_false_pin_withdraws_the_permission(self, live: Live) -> None:
        with live.opened(permissions={"doors_closed": "volcal-plant.probe"}) as device:
            assert Permission.DOORS_CLOSED in device.status().missing
            with pytest.raises(PermissionMissing, match="doors closed"):
                device.move_to(AWAY, feed_mm_per_s=None, guarded=True)

    def test_missing_pin_is_named(self, live: Live) -> None:
        refused = pytest.raises(CommandRejected, match=r"no-such\.pin")
        with live.opened(temperatures={"artefact": "no-such.pin"}) as device, refused:
            device.temperatures_c()


def test_doctor_moves_nothing_and_finds_nothing_wrong(live: Live, device: LinuxCnc) -> None:
    here = device.position()
    findings = device.diagnose()
    assert [finding for finding in findings if not finding.ok] == []
    assert np.array_equal(device.position(), here)
    assert "±2.5 µm" in {finding.subject: finding.text for finding in findings}["[EMCMOT]SERVO_PERIOD"]


def start_away(device: LinuxCnc) -> None:
    here = device.position()
    device.move_to(np.array([here[0], 0.0, here[2]]), feed_mm_per_s=None, guarded=True)
    device.move_to(AWAY, feed_mm_per_s=None, guarded=True)


def mdi(link: BridgeLink, *lines: str) -> None:
    for line in lines:
        link.ask("mdi", line=line)
        until(lambda: link.ask("status")["state"] == "done")


def pause() -> None:
    """Wait for half a second of machine time, long enough to detect a motion."""
    RealClock().sleep(0.5 / SPEED)
