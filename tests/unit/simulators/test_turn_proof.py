"""Proof that a turn is clear, compared with the bodies themselves at many instants."""

from __future__ import annotations

import numpy as np
import pytest
from worlds import ideal_world

from simulators.world.turn_collisions import first_turn_crash, is_turn_clear
from simulators.world.world import World
from twin.collision.geometry import Point, point, translate_point

TURNS = [((0.0, 0.0), (90.0, 45.0)), ((-60.0, 30.0), (45.0, -45.0)), ((120.0, -80.0), (-150.0, 60.0))]


def turning(start: tuple[float, float], end: tuple[float, float]) -> tuple[World, float]:
    """Return a world whose mount turns from `start` to `end`, and the end of that turn."""
    world = ideal_world()
    mount = world.mounts["mount"]
    for angles in (start, end):
        world.advance_to(mount.settled_s + 1.0)
        for axis, angle in zip(("azimuth", "elevation"), angles, strict=True):
            mount.begin_turn(axis, angle)
    return world, mount.settled_s


def least_clearance(world: World, tip: Point, end_s: float) -> float:
    instants = np.linspace(world.now, end_s, 200).tolist()
    return min(world.workpiece.snapshot(instant).scene.clearance(tip, at_most=200.0) for instant in instants)


@pytest.mark.parametrize(("start", "end"), TURNS)
def test_what_is_proved_is_so_and_what_is_far_away_is_proved(start, end) -> None:
    world, end_s = turning(start, end)
    rng = np.random.default_rng(4)
    proved = 0
    for offset in rng.uniform((-900.0, -950.0, -500.0), (900.0, 300.0, 900.0), (30, 3)):
        tip = translate_point(point(world.workpiece.location_mm), point(offset))
        if is_turn_clear(world.workpiece, tip, world.now, end_s):
            proved += 1
            assert least_clearance(world, tip, end_s) > 0.0
        else:
            assert least_clearance(world, tip, end_s) < 160.0
    assert 3 < proved < 27


def test_a_turn_that_is_not_proved_is_looked_at() -> None:
    """The tip rests just before the bar's end: nothing touches it at the start, then the bar arrives."""
    world, end_s = turning((0.0, 0.0), (-45.0, 0.0))
    ball = world.workpiece.snapshot(world.now).balls[8]
    tip = translate_point(ball, (0.0, -100.0, 0.0))
    assert not is_turn_clear(world.workpiece, tip, world.now, end_s)
    world.controller._position = translate_point(tip, point([-x for x in world.controller.tool_offset]))
    crash = first_turn_crash(world.workpiece, world.controller, world.now, end_s)
    assert crash is not None
    assert world.now < crash.time_s < end_s


def test_without_an_artefact_nothing_is_proved() -> None:
    world, end_s = turning((0.0, 0.0), (90.0, 0.0))
    world.workpiece.carry(None)
    assert not is_turn_clear(world.workpiece, (0.0, 0.0, 0.0), world.now, end_s)
