"""Plans are pure: the same settings and the same results give the same steps, whatever the results were."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from touched_ball import TouchedBall

from agent.errors import MeasurementFault
from agent.execution import steps as s
from agent.execution.encoding import encode_step
from agent.execution.tip_trace import LastMotion
from agent.planning.job import Job
from agent.planning.job_preparation import prepare_job
from agent.probing.ball_consistency import InconsistentBall
from agent.probing.paths.approach_points import TipLocation
from agent.probing.paths.shortest_path import ShortestPathPlanner, _TipState
from agent.probing.position import PositionTask, measure_position
from agent.probing.publish import choose_bank, stage_table
from agent.probing.recovery import withdraw
from agent.probing.run_plan import MeasuringOrder, measure_positions
from agent.settings.load import load_settings
from drivers.errors import ReadBackMismatch, StoreError, VolcalError
from drivers.roles import Miss, Orientation, TableImage, Touch
from twin.artefact.position_set import Position
from twin.collision.geometry import point

CONFIG = Path(__file__).resolve().parents[3] / "config" / "case-study.toml"
JOB: Job = prepare_job(load_settings(CONFIG), CONFIG.parent)
ORDER = MeasuringOrder("measure", (Position(1, 45.0, 0.0), Position(2, 0.0, 45.0)), 1)
CONTACT_MM = JOB.rules.probing.contact_mm
FEED_MM_PER_S = JOB.rules.probing.feed_mm_per_s
Answer = tuple[bool, float]


def played_through(plan: s.Plan[Any], results: Iterator[Any]) -> tuple[list[s.Step], str]:
    """Every step that the plan yields when it is sent `results` in turn, and how it ended."""
    seen: list[s.Step] = []
    result = None
    try:
        while True:
            seen.append(plan.send(result))
            result = next(results)
    except StopIteration:
        return seen, "done"
    except VolcalError as error:
        return seen, str(error)


class Answers:
    """A machine made of chance: touches scatter about where they should be, or miss. Keeps what it said."""

    def __init__(self, touches: Iterator[Answer]) -> None:
        self._touches = touches
        self.said: list[Any] = []

    def to(self, step: s.Step) -> Any:
        self.said.append(self._answer(step))
        return self.said[-1]

    def _answer(self, step: s.Step) -> Any:
        match step:
            case s.TouchTowards():
                hit, off_mm = next(self._touches, (True, 0.0))
                away = np.array(step.target_mm) + off_mm
                return (Touch if hit else Miss)((away[0], away[1], away[2]))
            case s.ReadPosition():
                return 0.0, 0.0, 0.0
            case s.ReadTemperatures():
                return {"artefact": 20.0}
            case s.ReadClock():
                return 0.0
            case s.OrientTo():
                return Orientation(step.azimuth_deg, step.elevation_deg)
        return None


def recorded(touches: list[Answer]) -> tuple[list[s.Step], str, list[Any]]:
    """The plan as it went for `touches`: its steps, its end, and every result."""
    answers = Answers(iter(touches))
    plan = measure_positions(ORDER, JOB.layout, JOB.rules)
    seen: list[s.Step] = []
    result = None
    try:
        while True:
            seen.append(plan.send(result))
            result = answers.to(seen[-1])
    except StopIteration:
        return seen, "done", answers.said
    except VolcalError as error:
        return seen, str(error), answers.said


scatter = st.floats(-0.02, 0.02) | st.floats(-3.0, 3.0)
some_touches = st.lists(st.tuples(st.booleans() | st.just(True), scatter), max_size=400)


@settings(deadline=None, max_examples=40)
@given(some_touches)
def test_rebuilt_plan_yields_the_same_steps_for_the_recorded_results(touches: list[Answer]) -> None:
    steps, end, results = recorded(touches)
    again, end_again = played_through(measure_positions(ORDER, JOB.layout, JOB.rules), iter(results))
    assert end_again == end
    assert [(x.key, type(x), encode_step(x)) for x in again] == [(x.key, type(x), encode_step(x)) for x in steps]


@settings(deadline=None, max_examples=40)
@given(some_touches)
def test_no_key_comes_twice_and_no_step_is_changed_afterwards(touches: list[Answer]) -> None:
    steps, _, _ = recorded(touches)
    keys = [step.key for step in steps]
    assert len(keys) == len(set(keys))
    for step in steps:
        with pytest.raises(dataclasses.FrozenInstanceError):
            step.key = "other"  # type: ignore[misc]


@settings(deadline=None, max_examples=40)
@given(some_touches)
def test_every_move_is_guarded_and_every_touch_slow(touches: list[Answer]) -> None:
    steps, _, _ = recorded(touches)
    for step in steps:
        if isinstance(step, s.MoveTo):
            assert step.guarded
        if isinstance(step, s.TouchTowards):
            slower = "/late-latch/" in step.key  # touches of a ball that appears too small
            assert step.feed_mm_per_s <= FEED_MM_PER_S if slower else step.feed_mm_per_s == FEED_MM_PER_S


def test_nothing_but_misses_ends_at_the_first_ball_and_names_it() -> None:
    steps, end, _ = recorded([(False, 0.0)] * 400)
    assert "end ball 0 was not found" in end
    assert "station-1/az45-el0/ball-00" in end
    balls = [x for x in steps if isinstance(x, s.Record) and x.kind == "ball"]
    assert balls == []
    assert MeasurementFault.exit_code == 4


def table(value: int) -> TableImage:
    return TableImage((0.0, 0.0, 0.0), (1.0, 1.0, 1.0), 1e-4, np.full((2, 2, 2, 3), value, dtype=np.int32))


@pytest.mark.parametrize(("banks", "active", "chosen"), [((1, 2), 0, 1), ((1, 2), 1, 2), ((0, 1, 2), 2, 1)])
def test_bank_that_does_not_act_is_chosen(banks: tuple[int, ...], active: int, chosen: int) -> None:
    assert choose_bank(banks, active) == chosen


def test_store_with_one_bank_has_no_place_for_a_second_table() -> None:
    with pytest.raises(StoreError, match="no inactive bank"):
        choose_bank((0, 1), 1)


@pytest.mark.parametrize("back", [None, table(2)])
def test_wrong_read_back_ends_the_plan(back: TableImage | None) -> None:
    plan = stage_table(1, table(1))
    assert isinstance(next(plan), s.StageTable)
    assert isinstance(plan.send(None), s.ReadTable)
    with pytest.raises(ReadBackMismatch):
        plan.send(back)


def test_withdrawal_goes_back_along_the_stylus_before_anything_else() -> None:
    plan = withdraw(JOB.rules.retreat, np.array([0.0, 1.0, 0.0]), 45.0)
    next(plan)
    assert isinstance(plan.send(None), s.ReadPosition)
    first = plan.send((100.0, 200.0, 300.0))
    assert isinstance(first, s.MoveTo)
    assert first.target_mm == (100.0, 155.0, 300.0)
    assert first.guarded
    second = plan.send(None)
    assert isinstance(second, s.MoveTo)
    assert second.target_mm == (100.0, 0.0, 300.0)


def last_motion(*, ended: bool) -> LastMotion:
    """A move of 100 mm along Y, ended or interrupted."""
    motion = LastMotion()
    motion.set_position((100.0, 100.0, 300.0))
    motion.begin((100.0, 200.0, 300.0), touch=False)
    if ended:
        motion.end((100.0, 200.0, 300.0))
    return motion


@pytest.mark.parametrize(
    ("here", "ended"),
    [
        ((3.94, 7.87, 11.81), True),  # inches
        ((100.0, 150.0, 300.0), True),
        ((100.0, 150.0, 320.0), False),
        ((100.0, 230.0, 300.0), False),
    ],
)
def test_nothing_is_withdrawn_from_a_position_that_the_last_motion_cannot_have_led_to(here, ended) -> None:
    motion = last_motion(ended=ended)
    plan = withdraw(JOB.rules.retreat, np.array([0.0, 1.0, 0.0]), 45.0, motion)
    next(plan)
    plan.send(None)
    motion.set_position(here)  # as the rig does when it reads the position
    with pytest.raises(MeasurementFault, match=r"mm off the line of its last motion: nothing is moved"):
        plan.send(here)


@pytest.mark.parametrize(("here", "ended"), [((100.0, 203.0, 300.0), True), ((101.0, 150.0, 300.0), False)])
def test_a_position_on_the_line_of_the_last_motion_is_withdrawn_from(here, ended) -> None:
    plan = withdraw(JOB.rules.retreat, np.array([0.0, 1.0, 0.0]), 45.0, last_motion(ended=ended))
    next(plan)
    plan.send(None)
    assert isinstance(plan.send(here), s.MoveTo)


def test_a_probe_that_others_may_have_moved_is_withdrawn_from_where_it_is() -> None:
    """In a run that is resumed the first process has withdrawn the probe; before an answer, a person may have moved
    it."""
    motion = last_motion(ended=False)
    motion.forget_line()
    plan = withdraw(JOB.rules.retreat, np.array([0.0, 1.0, 0.0]), 45.0, motion)
    next(plan)
    plan.send(None)
    assert isinstance(plan.send((900.0, 150.0, 300.0)), s.MoveTo)


@pytest.mark.parametrize("off_mm", [(0.0, -0.3, 0.0), (0.3, -0.2, 0.2), (-0.3, 0.3, -0.3)])
@pytest.mark.parametrize("position", [Position(4, 90.0, -90.0), Position(1, -135.0, 45.0)])
def test_the_way_out_of_an_artefact_that_stands_off_keeps_inside_the_travel(position, off_mm) -> None:
    """Parking places lie at the very end of the travel of Y."""
    path_rules, probing = JOB.rules.retreat.path_rules, JOB.rules.probing
    assert path_rules is not None
    finder = path_rules.finder_for(JOB.layout)
    pose = finder.pose_at(position.station, position.azimuth_deg, position.elevation_deg)
    centres = finder.ball_axes(pose, position.station) + np.array(off_mm)
    lower, upper = np.array(JOB.machine.limits).T
    reached = [ball for ball, centre in enumerate(centres) if (lower + 50.0 < centre).all() and (centre < upper).all()]
    corners = 0
    for ball, direction in product(reached, probing.directions):
        planner = ShortestPathPlanner(finder, JOB.rules.retreat, probing)
        steps = list(planner.take_over("a", position, ball, centres[ball]))
        last_touch = TipLocation(ball, point(direction), probing.contact_mm, touching=True)
        planner._set_tip(_TipState(last_touch, np.array(off_mm)), centres[ball] - probing.contact_mm * direction)
        steps += planner.leave("b", centres[ball])
        corners += sum("away" in step.key for step in steps)
        for step in steps:
            assert isinstance(step, s.MoveTo | s.Retrace | s.TouchTowards)
            assert (lower <= step.target_mm).all(), step
            assert (step.target_mm <= upper).all(), step
    assert corners


class KnockedRow(TouchedBall):
    """Four balls in a row, all of them displaced by `knock_mm` before the first step of ball `at`."""

    def __init__(self, task: PositionTask, at: int, knock_mm: float) -> None:
        super().__init__(task.predicted_mm[0], CONTACT_MM, lambda *_: 0.0)
        self.predicted_mm = task.predicted_mm
        self.knock_mm = knock_mm
        self.at_ball = at
        self.shift_mm = np.zeros(3)

    def to(self, step: s.Step) -> Any:
        match step:
            case s.ReadTemperatures():
                return {"artefact": 20.0}
            case s.ReadClock():
                return 0.0
            case s.MoveTo() | s.TouchTowards() if "/ball-" in step.key:
                ball = int(step.key.partition("/ball-")[2][:2])
                if ball == self.at_ball:
                    self.shift_mm = np.array([0.0, 0.0, self.knock_mm])
                self.centre_mm = self.predicted_mm[ball] + self.shift_mm
        return super().to(step)


@pytest.mark.parametrize("knock_mm", [1.0, -2.0, 0.0])
def test_balls_after_one_that_is_not_where_the_others_place_it_are_located_first(knock_mm: float) -> None:
    """The mount was knocked between two balls: the balls that follow are off by as much as the first one was found."""
    row_mm = np.array([1500.0, 700.0, 400.0]) + np.outer(np.arange(4.0) * 120.0, [1.0, 0.0, 0.0])
    task = PositionTask("row", 0, 1, 0.0, 0.0, row_mm, np.ones(4, dtype=bool))
    rules = replace(JOB.rules, drift=replace(JOB.rules.drift, limit_mm=10.0))
    player = KnockedRow(task, 2, knock_mm)
    found = player.run(measure_position(task, row_mm[0], rules))
    assert found.lost == 0
    off_mm = {ball.ball: ball.found.centre_mm - row_mm[ball.ball] for ball in found.balls}
    assert {ball: off[2] for ball, off in off_mm.items()} == pytest.approx({0: 0.0, 3: 0.0, 2: knock_mm, 1: knock_mm})
    located = {key.partition("/locate/")[0] for key in player.touched if "/locate/" in key}
    assert located == ({"row/ball-01", "row/ball-00/again"} if knock_mm else set())


class TwoInDoubt:
    """Consistency check that finds two balls inconsistent until they have been measured once more."""

    asked = 0

    def inconsistent(self, _: object) -> tuple[InconsistentBall, ...]:
        self.asked += 1
        return tuple(InconsistentBall(ball, 0, 9.0, 1.0) for ball in (3, 2)) if self.asked == 1 else ()


class KnockedOnceMore(KnockedRow):
    """Row that is displaced when ball 3 is measured once more."""

    def to(self, step: s.Step) -> Any:
        if "/ball-03/once-more/" in step.key:
            self.at_ball = 3
        return super().to(step)


def test_a_row_that_is_knocked_when_balls_are_measured_once_more_is_located_again() -> None:
    row_mm = np.array([1500.0, 700.0, 400.0]) + np.outer(np.arange(4.0) * 120.0, [1.0, 0.0, 0.0])
    task = PositionTask("row", 0, 1, 0.0, 0.0, row_mm, np.ones(4, dtype=bool))
    rules = replace(JOB.rules, drift=replace(JOB.rules.drift, limit_mm=10.0), consistency=TwoInDoubt())
    player = KnockedOnceMore(task, -1, 1.0)
    player.run(measure_position(task, row_mm[0], rules))
    located = {key.partition("/locate/")[0] for key in player.touched if "/locate/" in key}
    assert located == {"row/ball-02/once-more", "row/ball-00/again"}


def test_touches_that_locate_no_ball_end_at_it_with_the_reason() -> None:
    """Trips that fix no sphere: something else was touched."""
    _, end, _ = recorded([(True, 1.0), (True, 0.0), (True, 0.0), (True, 1.0), (True, -2.0)])
    assert "no sphere through the touches" in end
    assert "station-1/az45-el0/ball-00" in end
