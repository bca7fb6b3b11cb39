"""Device roles in one process, and a whole set measured with them."""

import math

import numpy as np
import pytest
from worlds import REACH, TOOL, before_ball, case_study, device, ideal_world

from agent.execution.supervisor import Supervisor
from drivers.clock import InterruptibleClock, VirtualClock
from drivers.errors import CommandRejected, DeadlineExpired, GuardTripped, MotionFault, StoreError
from drivers.roles import (
    CompensationStore,
    Machine,
    Miss,
    MotionState,
    Operator,
    OperatorRequest,
    OperatorTask,
    Probe,
    RotaryMount,
    TableImage,
    Thermometer,
    Touch,
)
from simulators.backend import SimulatedMachineDevice
from twin.artefact.position_set import mount_pose, parse_position_set

ROOT_HALF = math.sqrt(0.5)
DIRECTIONS = np.array([[0.0, 1.0, 0.0]] + [[a * ROOT_HALF, 0.0, b * ROOT_HALF] for a in (-1, 1) for b in (-1, 1)])


def test_it_plays_every_role() -> None:
    played, _ = device(ideal_world())
    for role in (Machine, Probe, RotaryMount, CompensationStore, Thermometer, Operator):
        assert isinstance(played, role)


def test_moves_take_the_time_they_take() -> None:
    played, clock = device(ideal_world())
    played.move_to(np.array([1000.0, 0.0, 0.0]), feed_mm_per_s=100.0, guarded=False)
    # 0.2 s and 10 mm for each ramp, 980 mm at 100 mm/s.
    assert clock.now() == pytest.approx(10.2)
    assert played.position().tolist() == [1000.0, 0.0, 0.0]


def test_touch_miss_guard_and_crash_are_told_apart() -> None:
    world = ideal_world()
    played, _ = device(world)
    centre = before_ball(world, 5)
    back = centre - [0.0, 20.0, 0.0]
    short = back + np.array([0.0, 3.0, 0.0])
    assert played.touch_towards(short, feed_mm_per_s=5.0) == Miss(tuple(short))
    touch = played.touch_towards(centre, feed_mm_per_s=5.0)
    assert isinstance(touch, Touch)
    assert touch.position_mm[1] == pytest.approx(centre[1] - REACH)
    assert played.probe_status().deflected
    with pytest.raises(CommandRejected, match="deflected"):
        played.touch_towards(centre, feed_mm_per_s=5.0)
    played.move_to(back, feed_mm_per_s=5.0, guarded=True)
    with pytest.raises(GuardTripped, match="probe tripped"):
        played.move_to(centre, feed_mm_per_s=10.0, guarded=True)
    assert played.status().state is MotionState.IDLE, "the way back out is open, as the role says"
    played.move_to(back, feed_mm_per_s=5.0, guarded=True)
    with pytest.raises(MotionFault, match="tip with ball 5") as caught:
        played.move_to(centre, feed_mm_per_s=10.0, guarded=False)
    assert not isinstance(caught.value, GuardTripped)


def test_an_emergency_stop_in_a_guarded_move_is_no_guard_and_stays_a_fault() -> None:
    def press() -> None:
        if clock.now() > 1.0:
            world.controller.fail("emergency stop")

    world, clock = ideal_world(), VirtualClock()
    clock.subscribe(world.advance_to)
    played = SimulatedMachineDevice(world, InterruptibleClock(clock, press))
    with pytest.raises(MotionFault, match="emergency stop") as caught:
        played.move_to(np.array([1000.0, 0.0, 0.0]), feed_mm_per_s=100.0, guarded=True)
    assert not isinstance(caught.value, GuardTripped)
    assert played.status().state is MotionState.FAULT


def test_a_wait_that_is_broken_off_stops_the_machine() -> None:
    class EnoughError(Exception):
        pass

    def check() -> None:
        if inner.now() > 1.0:
            raise EnoughError

    inner = VirtualClock()
    world = ideal_world()
    played = SimulatedMachineDevice(world, InterruptibleClock(inner, check))
    inner.subscribe(world.advance_to)
    played.open()
    with pytest.raises(EnoughError):
        played.move_to(np.array([4000.0, 0.0, 0.0]), feed_mm_per_s=100.0, guarded=False)
    inner.advance_to(60.0)
    assert world.controller.motion is MotionState.IDLE
    assert 100.0 < world.controller.displayed_position()[0] < 130.0


def test_a_hold_longer_than_the_margin_of_a_motion_is_no_missed_deadline_and_no_later_motion_takes_longer() -> None:
    """The clock of the machine is not the world's own, as with a simulated machine on the wall clock."""
    inner, world = VirtualClock(), ideal_world()
    supervisor = Supervisor(inner)
    clock = InterruptibleClock(inner, supervisor.check)
    played = SimulatedMachineDevice(world, clock)
    played.open()
    supervisor.on_hold, supervisor.on_resume = played.hold, played.resume

    def people(now: float) -> None:
        if 1.0 <= now < 2.0:
            supervisor.request_hold()
        if now >= 601.0:
            supervisor.request_resume()

    inner.subscribe(people)
    played.move_to(np.array([1000.0, 0.0, 0.0]), feed_mm_per_s=100.0, guarded=False)
    assert played.position().tolist() == [1000.0, 0.0, 0.0]
    assert inner.now() == pytest.approx(601.0 + 9.4, abs=0.2)  # 10.2 s less 1 s, and two more ramps
    began_s = clock.now()
    played.move_to(np.zeros(3), feed_mm_per_s=100.0, guarded=False)
    assert clock.now() - began_s == pytest.approx(10.2, abs=1e-9)


def test_a_machine_held_for_ever_is_a_missed_deadline() -> None:
    world = ideal_world()
    clock = VirtualClock()
    clock.subscribe(world.advance_to)
    played = SimulatedMachineDevice(world, InterruptibleClock(clock, world.controller.hold))
    with pytest.raises(DeadlineExpired):
        played.move_to(np.array([100.0, 0.0, 0.0]), feed_mm_per_s=10.0, guarded=False)


def test_a_table_is_staged_read_back_and_activated() -> None:
    played, _ = device(ideal_world())
    table = TableImage((0.0, 0.0, 0.0), (2000.0, 1300.0, 1500.0), 1e-4, np.ones((3, 2, 2, 3), dtype=np.int32))
    assert played.read_table(1) is None
    played.stage(1, table)
    read = played.read_table(1)
    assert read is not None
    assert read.same_as(table)
    played.activate(1)
    assert played.active_bank() == 1
    with pytest.raises(StoreError, match="active"):
        played.stage(1, table)
    with pytest.raises(StoreError, match="no table"):
        played.activate(2)


def test_the_operator_moves_the_artefact() -> None:
    world = ideal_world()
    played, _ = device(world)
    assert played.ask(OperatorRequest(OperatorTask.MOVE_ARTEFACT, "to 3", 3))
    assert world.workpiece.station == 3
    assert played.ask(OperatorRequest(OperatorTask.CONSENT, "write?"))
    assert not played.ask(OperatorRequest(OperatorTask.MOVE_ARTEFACT, "where?"))


def test_temperatures_have_their_names() -> None:
    played, _ = device(ideal_world())
    assert {"artefact", "machine", "ambient"} <= set(played.temperatures_c())


@pytest.mark.parametrize("position", parse_position_set("S3", 1), ids=str)
def test_every_ball_of_s3_is_found_exactly_without_a_collision(position) -> None:
    world = ideal_world()
    played, _ = device(world)
    played.move_to(np.array([2900.0, 0.0, 750.0]), feed_mm_per_s=None, guarded=False)
    played.orient_to(position.azimuth_deg, position.elevation_deg)
    settings, artefact = case_study().settings, case_study().artefact
    pose = mount_pose(
        np.array(settings.stations_mm[1]), settings.mount,
        math.radians(position.azimuth_deg), math.radians(position.elevation_deg),
    )  # fmt: skip
    centres = pose.apply(artefact.balls) - TOOL
    played.move_to(centres[0] * [1.0, 0.0, 1.0], feed_mm_per_s=None, guarded=True)
    for centre in centres:
        touches = [_touched(played, centre, direction) for direction in DIRECTIONS]
        assert np.mean(touches[1:], axis=0) == pytest.approx(centre, abs=1e-6)
        assert touches[0] == pytest.approx(centre - [0.0, REACH, 0.0], abs=1e-6)
    assert world.collisions == []


def _touched(played: SimulatedMachineDevice, centre: np.ndarray, direction: np.ndarray) -> np.ndarray:
    """Approach along +Y beside the ball, touch, and withdraw along the same path."""
    start = centre - direction * (REACH + 4.0)
    away = np.array([start[0], centre[1] - 60.0, start[2]])
    for target in (centre - [0.0, 60.0, 0.0], away, start):
        played.move_to(target, feed_mm_per_s=None, guarded=True)
    touch = played.touch_towards(centre - direction * (REACH - 2.0), feed_mm_per_s=5.0)
    for target in (start, away, centre - [0.0, 60.0, 0.0]):
        played.move_to(target, feed_mm_per_s=None, guarded=True)
    assert isinstance(touch, Touch)
    return np.array(touch.position_mm)
