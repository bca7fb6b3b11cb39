from dataclasses import replace

import numpy as np
import pytest
import worlds
from worlds import REACH, before_ball, case_study, ideal_world, moved, run

from drivers.errors import CommandRejected
from drivers.roles import MotionState, Permission
from simulators.world.world import World

FORWARD = np.array([0.0, 1.0, 0.0])


def motion_state(world: World) -> MotionState:
    """Return the state of motion, read anew so that a type checker does not keep the state compared before."""
    return world.controller.motion


def test_a_touch_latches_at_contact_and_stops_behind_it() -> None:
    world = ideal_world()
    centre = before_ball(world, 5)
    controller = world.controller
    controller.begin_touch(centre, 5.0)
    assert motion_state(world) is MotionState.MOVING
    run(world)
    assert motion_state(world) is MotionState.IDLE
    assert controller.latch is not None
    assert controller.latch.position == pytest.approx(centre - FORWARD * REACH, abs=1e-9)
    # v²/2a = 25 / 1000: it rests 25 µm behind the trip and still presses.
    assert controller.displayed_position()[1] - controller.latch.position[1] == pytest.approx(0.025)
    assert controller.probe_deflected
    assert not controller.touch_missed


def test_the_latch_comes_at_its_instant_whatever_the_steps_of_time() -> None:
    world = ideal_world()
    centre = before_ball(world, 5)
    world.controller.begin_touch(centre, 5.0)
    # 20 - 15.5 mm at 5 mm/s: 4.5/5 s and half a ramp of 10 ms.
    trip_s = world.now + 4.5 / 5.0 + 0.5 * 5.0 / 500.0
    world.advance_to(trip_s - 1e-6)
    assert world.controller.latch is None
    assert not world.controller.probe_deflected
    for step in range(1, 100):
        world.advance_to(trip_s + step * 1e-3)
    assert world.controller.latch is not None
    assert world.controller.latch.position == pytest.approx(centre - FORWARD * REACH, abs=1e-9)


def test_a_touch_into_the_air_is_a_miss() -> None:
    world = ideal_world()
    centre = before_ball(world, 5)
    world.controller.begin_touch(centre - FORWARD * 16.0, 5.0)
    run(world)
    assert world.controller.touch_missed
    assert world.controller.latch is None
    assert world.controller.displayed_position() == pytest.approx(centre - FORWARD * 16.0)


def test_a_guarded_move_that_trips_is_a_fault_and_no_collision() -> None:
    world = ideal_world()
    centre = before_ball(world, 5)
    world.controller.begin_move(centre, 40.0, guarded=True)
    run(world)
    assert motion_state(world) is MotionState.FAULT
    assert "probe tripped" in world.controller.fault
    assert world.collisions == []
    world.controller.reset()
    world.controller.begin_move(centre - FORWARD * 60.0, None, guarded=True)
    run(world)
    assert motion_state(world) is MotionState.IDLE
    assert not world.controller.probe_deflected


def test_a_guarded_move_too_fast_to_stop_in_time_crashes() -> None:
    world = ideal_world()
    centre = before_ball(world, 5, distance=200.0)
    world.controller.begin_move(centre, None, guarded=True)
    run(world)
    assert [(c.body_a, c.body_b) for c in world.collisions] == [("tip", "ball 5")]
    overtravel = world.scenario.settings.trigger.overtravel_mm
    assert world.controller.displayed_position() == pytest.approx(centre - FORWARD * (REACH - overtravel))


def test_an_unguarded_move_into_a_ball_is_a_collision_at_the_contact() -> None:
    world = ideal_world()
    centre = before_ball(world, 5)
    world.controller.begin_move(centre, 10.0, guarded=False)
    run(world)
    assert world.controller.motion is MotionState.FAULT
    assert world.controller.fault == "collision: tip with ball 5"
    assert world.controller.displayed_position() == pytest.approx(centre - FORWARD * REACH)
    assert [(c.body_a, c.body_b) for c in world.collisions] == [("tip", "ball 5")]


def test_a_move_sideways_behind_the_balls_hits_with_the_stem() -> None:
    world = ideal_world()
    centre = before_ball(world, 5, distance=60.0)
    # Ball 6 stands 150 mm on, 15.5 mm lower and 15.5 mm deeper; the bar is 60 mm behind ball 5.
    between = centre + np.array([75.0, -60.0, -15.5])
    moved(world, between)
    moved(world, between + FORWARD * 105.0)
    moved(world, between + np.array([75.0, 105.0, 0.0]))
    assert world.controller.motion is MotionState.FAULT
    assert [(c.body_a, c.body_b) for c in world.collisions] == [("stem", "ball 6")]


def test_the_bar_and_the_table_are_solid() -> None:
    world = ideal_world()
    centre = before_ball(world, 5, distance=60.0)
    moved(world, centre + np.array([75.0, -60.0, 0.0]))
    moved(world, centre + np.array([75.0, 100.0, 0.0]))
    assert [c.body_b for c in world.collisions] == ["bar"]


def test_commands_outside_travel_or_without_sense_are_rejected_and_move_nothing() -> None:
    world = ideal_world()
    controller = world.controller
    before = controller.displayed_position()
    for target in ([4000.1, 0.0, 0.0], [0.0, -0.1, 0.0], [0.0, 0.0, np.nan]):
        with pytest.raises(CommandRejected, match="outside"):
            controller.begin_move(np.array(target), None, guarded=False)
    with pytest.raises(CommandRejected, match="feed"):
        controller.begin_move(np.array([1.0, 0.0, 0.0]), 0.0, guarded=False)
    assert controller.motion is MotionState.IDLE
    assert controller.displayed_position().tolist() == before.tolist()


def test_a_second_command_has_to_wait() -> None:
    world = ideal_world()
    world.controller.begin_move(np.array([100.0, 0.0, 0.0]), None, guarded=False)
    with pytest.raises(CommandRejected, match="not ready"):
        world.controller.begin_move(np.array([200.0, 0.0, 0.0]), None, guarded=False)


def test_a_deflected_probe_neither_touches_nor_presses_on_but_backs_off() -> None:
    world = ideal_world()
    centre = before_ball(world, 5)
    controller = world.controller
    controller.begin_touch(centre, 5.0)
    run(world)
    with pytest.raises(CommandRejected, match="deflected"):
        controller.begin_touch(centre, 5.0)
    with pytest.raises(CommandRejected, match="deflected"):
        controller.begin_move(centre, 5.0, guarded=True)
    controller.begin_move(centre - FORWARD * 20.0, 5.0, guarded=True)
    assert controller.probe_deflected
    run(world)
    assert not controller.probe_deflected
    assert controller.motion is MotionState.IDLE


def test_pressing_on_without_guard_ends_at_the_overtravel() -> None:
    world = ideal_world()
    centre = before_ball(world, 5)
    world.controller.begin_touch(centre, 5.0)
    run(world)
    moved(world, centre)
    overtravel = world.scenario.settings.trigger.overtravel_mm
    assert [(c.body_a, c.body_b) for c in world.collisions] == [("tip", "ball 5")]
    assert world.controller.displayed_position()[1] == pytest.approx(centre[1] - REACH + overtravel)


def test_a_hold_brakes_and_a_resume_goes_on_to_the_same_latch() -> None:
    world = ideal_world()
    centre = before_ball(world, 5)
    controller = world.controller
    controller.begin_touch(centre, 5.0)
    world.advance_to(world.now + 0.3)
    controller.hold()
    run(world)
    assert controller.motion is MotionState.HELD
    assert controller.motion_ends_s is None
    controller.resume()
    run(world)
    assert controller.latch is not None
    assert controller.latch.position == pytest.approx(centre - FORWARD * REACH, abs=1e-9)


def late_probe() -> World:
    """Return a world without errors whose probe trips 100 µm behind the contact."""
    ideal = case_study().without_errors()
    trigger = ideal.settings.trigger.model_copy(update={"pretravel_um": 100.0})
    world = World(replace(ideal, settings=ideal.settings.model_copy(update={"trigger": trigger})))
    world.place_artefact(2)
    return world


@pytest.mark.parametrize("guarded", [False, True])
def test_a_tip_that_was_held_in_contact_before_the_trip_trips_as_it_goes_on(guarded: bool) -> None:
    """Between contact and trip the probe is not deflected yet, and the ball is not open to the tip either."""
    world = late_probe()
    centre, controller = before_ball(world, 5), world.controller
    if guarded:
        controller.begin_move(centre, 5.0, guarded=True)
    else:
        controller.begin_touch(centre, 5.0)
    # contact after 4.5 mm; a hold 10 µm behind it stands 35 µm behind it (v²/2a = 25 µm), before the trip at 100 µm
    world.advance_to(world.now + 4.51 / 5.0 + 0.5 * 5.0 / 500.0)
    controller.hold()
    run(world)
    assert controller.motion is MotionState.HELD
    assert controller.displayed_position() == pytest.approx(centre - FORWARD * (REACH - 0.035), abs=1e-9)
    assert not controller.probe_deflected
    controller.resume()
    run(world)
    assert world.collisions == []
    assert controller.probe_deflected
    if guarded:
        assert "probe tripped" in controller.fault
    else:
        assert controller.latch is not None
        assert controller.latch.position == pytest.approx(centre - FORWARD * (REACH - 0.1), abs=1e-9)


def test_a_probe_stays_deflected_if_its_way_back_is_halted_at_the_start() -> None:
    world = ideal_world()
    centre, controller = before_ball(world, 5), world.controller
    controller.begin_touch(centre, 5.0)
    run(world)
    assert controller.probe_deflected
    controller.begin_move(centre - FORWARD * 60.0, None, guarded=True)
    controller.halt()
    assert motion_state(world) is MotionState.IDLE
    assert controller.probe_deflected
    controller.begin_move(centre - FORWARD * 60.0, None, guarded=True)
    run(world)
    assert not controller.probe_deflected
    assert world.collisions == []


def test_a_tip_in_contact_before_the_trip_is_no_obstacle_to_itself() -> None:
    """It backs off freely, and a positioning move that presses on is a collision at once."""
    for away in (True, False):
        world = late_probe()
        centre, controller = before_ball(world, 5), world.controller
        controller.begin_touch(centre, 5.0)
        world.advance_to(world.now + 4.51 / 5.0 + 0.5 * 5.0 / 500.0)
        controller.halt()
        run(world)
        at = controller.displayed_position()
        controller.begin_move(at + FORWARD * (-5.0 if away else 5.0), 5.0, guarded=False)
        run(world)
        assert [(one.body_a, one.body_b) for one in world.collisions] == ([] if away else [("tip", "ball 5")])
        assert away or controller.displayed_position() == pytest.approx(at, abs=1e-9)


def test_a_motion_that_has_not_left_its_start_ends_with_the_hold_or_the_halt() -> None:
    world = ideal_world()
    controller = world.controller
    target = np.array([1000.0, 0.0, 0.0])
    controller.begin_move(target, 100.0, guarded=False)
    controller.hold()
    assert (controller.motion, controller.motion_ends_s) == (MotionState.HELD, None)
    controller.resume()
    run(world)
    assert controller.displayed_position().tolist() == target.tolist()
    controller.begin_move(np.zeros(3), 100.0, guarded=False)
    controller.halt()
    assert (controller.motion, controller.motion_ends_s) == (MotionState.IDLE, None)
    assert controller.displayed_position().tolist() == target.tolist()


def test_a_halt_forgets_the_command_and_may_be_said_twice() -> None:
    world = ideal_world()
    controller = world.controller
    controller.begin_move(np.array([1000.0, 0.0, 0.0]), 100.0, guarded=False)
    world.advance_to(1.0)
    controller.halt()
    run(world)
    controller.halt()
    controller.resume()
    assert controller.motion is MotionState.IDLE
    # 0.2 s and 10 mm up, 0.8 s at 100 mm/s, 10 mm down.
    assert controller.displayed_position()[0] == pytest.approx(10.0 + 80.0 + 10.0)


def test_a_hold_in_time_prevents_a_foreseen_crash() -> None:
    world = ideal_world()
    centre = before_ball(world, 5, distance=200.0)
    world.controller.begin_move(centre, 50.0, guarded=False)
    world.advance_to(world.now + 3.0)
    world.controller.hold()
    run(world)
    assert world.controller.motion is MotionState.HELD
    assert world.collisions == []


def test_a_fault_from_outside_brakes_and_stays_until_reset() -> None:
    world = ideal_world()
    controller = world.controller
    controller.begin_move(np.array([1000.0, 0.0, 0.0]), 100.0, guarded=False)
    world.advance_to(1.0)
    controller.fail("heartbeat lost")
    run(world)
    assert (controller.motion, controller.fault) == (MotionState.FAULT, "heartbeat lost")
    assert not controller.permissions[Permission.NO_FAULT]
    controller.halt()
    assert controller.motion is MotionState.FAULT
    controller.reset()
    assert (controller.motion, controller.fault) == (MotionState.IDLE, "")


def test_without_a_permission_or_a_probe_nothing_starts() -> None:
    world = ideal_world()
    world.controller.granted[Permission.DOORS_CLOSED] = False
    with pytest.raises(CommandRejected, match="doors closed"):
        world.controller.begin_move(np.array([1.0, 0.0, 0.0]), None, guarded=False)
    world.controller.granted[Permission.DOORS_CLOSED] = True
    world.controller.probe_loaded = False
    with pytest.raises(CommandRejected, match="healthy probe"):
        world.controller.begin_touch(np.array([1.0, 0.0, 0.0]), 5.0)


def test_the_same_touches_have_the_same_noise_in_every_world() -> None:
    latches = []
    for steps in (1, 7):
        world = worlds.World(worlds.case_study())
        centre = np.round(before_ball(world, 5), 3)
        for _ in range(3):
            world.controller.begin_touch(centre, 5.0)
            begun, ends = world.now, world.controller.motion_ends_s or 0.0
            for step in range(1, steps + 1):
                world.advance_to(begun + (ends - begun) * step / steps)
            run(world)
            assert world.controller.latch is not None
            latches.append(world.controller.latch.position[1])
            moved(world, centre - FORWARD * 20.0)
    assert latches[:3] == latches[3:]
    assert len(set(latches)) == 3
    assert max(latches) - min(latches) < 0.01
