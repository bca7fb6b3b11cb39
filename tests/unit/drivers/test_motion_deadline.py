"""Tests of the time limit of a motion and of the check of the position at its end."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.clock import VirtualClock
from drivers.errors import DeadlineExpired, MotionFault
from drivers.motion_deadline import MotionDeadline
from drivers.reached_position import require_reached

TARGET, START = (100.0, 0.0, 0.0), (0.0, 0.0, 0.0)


def deadline(clock: VirtualClock) -> MotionDeadline:
    return MotionDeadline(clock, TARGET, START, allowed_s=8.0, stall_s=5.0)


def test_it_does_not_expire_while_the_axes_approach_the_target() -> None:
    clock = VirtualClock()
    limit = deadline(clock)
    for step in range(1, 101):
        clock.sleep(2.0)
        limit.observe((0.002 * step, 0.0, 0.0))
        assert not limit.expired
    clock.sleep(5.1)
    assert limit.expired


def test_oscillation_is_no_progress() -> None:
    clock = VirtualClock()
    limit = deadline(clock)
    for step in range(10):
        clock.sleep(1.0)
        limit.observe((1.0 + step % 2, 0.0, 0.0))
    with pytest.raises(DeadlineExpired, match="the axes move, but do not approach the target"):
        limit.raise_if_expired("MOVE FEED", {})


def test_it_restarts_after_a_hold() -> None:
    clock = VirtualClock()
    limit = deadline(clock)
    clock.sleep(600.0)
    limit.restart()
    clock.sleep(7.9)
    limit.raise_if_expired("MOVE FEED", {})
    clock.sleep(0.2)
    with pytest.raises(DeadlineExpired, match=r"stood still for 8\.1 s .*feed override"):
        limit.raise_if_expired("MOVE FEED", {"device": "cnc"})


@given(st.tuples(*[st.floats(-1e4, 1e4)] * 3), st.integers(0, 2), st.floats(-5.0, 5.0))
def test_a_deviation_is_a_fault_if_and_only_if_it_exceeds_the_limit(
    target: tuple[float, float, float], axis: int, off_mm: float
) -> None:
    reported = list(target)
    reported[axis] += off_mm
    if abs(reported[axis] - target[axis]) <= 0.05:
        require_reached(reported, target, 0.05, "move", {})
    elif abs(reported[axis] - target[axis]) > 0.051:
        with pytest.raises(MotionFault, match=f"{'XYZ'[axis]} target"):
            require_reached(reported, target, 0.05, "move", {})


@pytest.mark.parametrize("axis", range(3))
def test_a_position_that_is_no_number_has_not_reached_its_target(axis: int) -> None:
    reported = [100.0, 0.0, 0.0]
    reported[axis] = math.nan
    with pytest.raises(MotionFault, match=f"{'XYZ'[axis]} target"):
        require_reached(reported, TARGET, 0.05, "move", {})
