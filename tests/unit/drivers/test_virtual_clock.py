"""Tests of virtual time: a wait for an instant always reaches it."""

from __future__ import annotations

from drivers.clock import InterruptibleClock, VirtualClock


def test_time_passes_however_short_the_sleep() -> None:
    clock = VirtualClock()
    clock.advance_to(1e6)
    clock.sleep(1e-20)
    assert clock.now() > 1e6


def test_an_instant_just_ahead_is_reached_after_a_hold_too() -> None:
    """A hold shifts the clock of the run against that of the world by an offset that no sleep matches exactly."""
    clock = VirtualClock()
    held = iter([0.1 + 0.2])
    watched = InterruptibleClock(clock, lambda: clock.sleep(next(held, 0.0)))
    watched.sleep(1.0 / 3.0)
    instant = watched.now() + 0.7
    for _ in range(100):
        if watched.now() >= instant:
            break
        watched.sleep(instant - watched.now())
    assert watched.now() >= instant


def test_no_time_passes_in_a_sleep_of_zero() -> None:
    clock = VirtualClock()
    clock.sleep(0.0)
    clock.sleep(-1.0)
    assert clock.now() == 0.0
