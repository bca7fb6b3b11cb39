"""Contract tests of the device roles `Machine`, `Probe` and `RotaryMount`.

Every driver of such a role must pass them. Each test uses the fixture `rig`, a `ContractRig` with the device under
test.
"""
# ruff: noqa: S101  contract tests assert

from __future__ import annotations

import math
import re

import numpy as np
import pytest

from drivers.contract.rig import ContractRig, StoppedError
from drivers.errors import CommandRejected, DeviceError, GuardTripped
from drivers.roles import AxisHoming, Machine, Miss, MotionState, Probe, RotaryMount, Touch

SLOW_MM_PER_S = 50.0
POLL_S = 0.05


class MachineContract:
    def test_implements_the_role(self, rig: ContractRig) -> None:
        assert isinstance(rig.machine, Machine)

    def test_move_reaches_its_target(self, rig: ContractRig) -> None:
        rig.go(rig.start_mm)
        rig.machine.move_to(np.array(rig.free_mm), feed_mm_per_s=SLOW_MM_PER_S, guarded=False)
        assert rig.machine.position() == pytest.approx(rig.free_mm, abs=rig.resolution_mm)
        assert rig.machine.status().state is MotionState.IDLE

    def test_target_outside_the_travel_is_rejected_and_nothing_moves(self, rig: ContractRig) -> None:
        before = rig.machine.position()
        for target in (*rig.outside_mm, (math.nan, 0.0, 0.0)):
            with pytest.raises(CommandRejected):
                rig.go(target)
            assert np.array_equal(rig.machine.position(), before)
        rig.go(before)

    @pytest.mark.parametrize("feed", [0.0, -5.0, math.inf, math.nan])
    def test_invalid_feed_is_rejected(self, rig: ContractRig, feed: float) -> None:
        with pytest.raises(CommandRejected):
            rig.machine.move_to(np.array(rig.free_mm), feed_mm_per_s=feed, guarded=False)

    def test_guarded_move_into_an_obstacle_trips_the_guard(self, rig: ContractRig) -> None:
        target = rig.approach()
        direction = rig.towards(target)
        with pytest.raises(GuardTripped):
            rig.machine.move_to(target, feed_mm_per_s=10.0, guarded=True)
        assert rig.machine.status().state is not MotionState.MOVING
        beyond_mm = float((rig.machine.position() - rig.trip_mm(target)) @ direction)
        assert 0.0 < beyond_mm < 6.0

    def test_interrupted_wait_stops_the_motion(self, rig: ContractRig) -> None:
        rig.go(rig.start_mm)
        rig.interrupt.after(2.0)
        with pytest.raises(StoppedError):
            target = np.add(rig.start_mm, (6.0 * SLOW_MM_PER_S, 0.0, 0.0))
            rig.machine.move_to(target, feed_mm_per_s=SLOW_MM_PER_S, guarded=False)
        rig.await_rest()
        stopped = rig.machine.position()
        assert SLOW_MM_PER_S < stopped[0] - rig.start_mm[0] < 4.0 * SLOW_MM_PER_S
        rig.clock.sleep(5.0)
        assert np.array_equal(rig.machine.position(), stopped)
        rig.go(rig.start_mm)

    def test_a_hold_that_is_released_as_soon_as_the_axes_stand_continues_the_motion(self, rig: ContractRig) -> None:
        held = []

        def hold_and_resume() -> None:
            rig.machine.hold()
            while rig.machine.status().state is MotionState.MOVING:
                rig.interrupt.clock.sleep(POLL_S)
            held.append(rig.machine.position()[0])
            rig.machine.resume()

        rig.go(rig.start_mm)
        rig.interrupt.after(2.0, hold_and_resume)
        target = np.add(rig.start_mm, (6.0 * SLOW_MM_PER_S, 0.0, 0.0))
        rig.machine.move_to(target, feed_mm_per_s=SLOW_MM_PER_S, guarded=False)
        assert rig.machine.position() == pytest.approx(target, abs=rig.resolution_mm)
        assert held[0] < target[0] - SLOW_MM_PER_S
        rig.go(rig.start_mm)

    def test_stop_at_rest_does_no_harm(self, rig: ContractRig) -> None:
        rig.machine.stop()
        rig.machine.stop()
        rig.go(rig.free_mm)
        assert rig.machine.position() == pytest.approx(rig.free_mm, abs=rig.resolution_mm)


class AxisHomingContract:
    """Contract of the optional role of a machine whose axes may be homed on command."""

    def test_homing_is_carried_out_or_refused_in_words(self, rig: ContractRig) -> None:
        machine = rig.machine
        assert isinstance(machine, AxisHoming)
        assert set(machine.homing_directions()) <= {-1, 0, 1}
        reason = machine.why_no_homing()
        rig.go(rig.start_mm)
        before = rig.machine.position()
        if reason:
            with pytest.raises(CommandRejected, match=re.escape(reason)):
                machine.home_axes()
            assert np.array_equal(rig.machine.position(), before)
            return
        machine.home_axes()
        status = rig.machine.status()
        assert (status.state, status.missing) == (MotionState.IDLE, ())
        homed, limits = rig.machine.position(), rig.machine.limits()
        for axis, direction in enumerate(machine.homing_directions()):
            low, high = limits.lower_mm[axis], limits.upper_mm[axis]
            assert direction * (homed[axis] - 0.5 * (low + high)) >= 0.0
        machine.home_axes()
        assert rig.machine.position() == pytest.approx(homed, abs=rig.resolution_mm)


class ProbeContract:
    def test_implements_the_role(self, rig: ContractRig) -> None:
        assert isinstance(rig.probe, Probe)

    def test_touch_is_the_trip_position_not_the_stop_position(self, rig: ContractRig) -> None:
        target = rig.approach()
        direction = rig.towards(target)
        touch = rig.probe.touch_towards(target, feed_mm_per_s=5.0)
        assert isinstance(touch, Touch)
        assert touch.position_mm == pytest.approx(tuple(rig.trip_mm(target)), abs=max(rig.resolution_mm, 1e-5))
        assert (rig.machine.position() - touch.position_mm) @ direction > 0.0
        assert rig.probe.probe_status().deflected

    def test_miss_is_a_result(self, rig: ContractRig) -> None:
        direction = rig.towards(rig.approach())
        short = rig.machine.position() + 5.0 * direction
        miss = rig.probe.touch_towards(short, feed_mm_per_s=5.0)
        assert isinstance(miss, Miss)
        assert miss.position_mm == pytest.approx(tuple(short), abs=max(rig.resolution_mm, 1e-6))
        assert not rig.probe.probe_status().deflected

    def test_second_touch_has_its_own_latch(self, rig: ContractRig) -> None:
        target = rig.approach()
        before, direction = rig.machine.position(), rig.towards(target)
        first = rig.probe.touch_towards(target, feed_mm_per_s=5.0)
        rig.machine.move_to(before, feed_mm_per_s=None, guarded=True)
        second = rig.probe.touch_towards(before + 5.0 * direction, feed_mm_per_s=5.0)
        assert isinstance(first, Touch)
        assert isinstance(second, Miss)

    def test_deflected_probe_does_not_touch(self, rig: ContractRig) -> None:
        target = rig.approach()
        rig.probe.touch_towards(target, feed_mm_per_s=5.0)
        with pytest.raises(DeviceError, match="deflected"):
            rig.probe.touch_towards(target, feed_mm_per_s=5.0)

    def test_loaded_healthy_and_free(self, rig: ContractRig) -> None:
        status = rig.probe.probe_status()
        assert (status.loaded, status.healthy, status.deflected) == (True, True, False)


class RotaryMountContract:
    def test_implements_the_role(self, rig: ContractRig) -> None:
        assert isinstance(rig.mount, RotaryMount)

    def test_turn_reaches_its_target(self, rig: ContractRig) -> None:
        rig.go(rig.clear_of_mount_mm)
        reached = rig.mount.orient_to(45.0, -30.0)
        assert (reached.azimuth_deg, reached.elevation_deg) == pytest.approx((45.0, -30.0), abs=1e-3)
        assert rig.mount.orientation() == reached

    def test_interrupted_wait_stops_the_turn(self, rig: ContractRig) -> None:
        rig.go(rig.clear_of_mount_mm)
        rig.interrupt.after(1.5)
        with pytest.raises(StoppedError):
            rig.mount.orient_to(90.0, 0.0)
        rig.clock.sleep(3.0)
        stopped = rig.mount.orientation()
        rig.clock.sleep(5.0)
        assert rig.mount.orientation() == stopped
