"""Machine time: the walked plan against the simulated dry run, hand calculation, and the journal's clock."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from volcal_command import volcal, volcal_json

from agent.errors import Aborted
from agent.execution.steps import AskOperator, MoveTo, OrientTo, Step, TouchTowards
from agent.planning.case_file import CASE_STUDY
from agent.planning.cycle_time import (
    CARRYING,
    PARTS,
    expected_plan,
    machine_minutes,
    minutes_by_part,
    position_minutes,
    walk_plan,
)
from agent.planning.job import Job
from agent.planning.job_preparation import prepare_job
from agent.planning.time_model import TimeModel
from agent.probing.run_plan import MeasuringOrder, measure_positions
from agent.runs.kinds.calibrate import calibration_of, preflight_of
from agent.settings.load import load_settings, with_overrides
from drivers.roles import OperatorRequest, OperatorTask
from twin.artefact.position_set import Position
from twin.collision.motion_law import straight_path

MODEL = TimeModel(
    rapid_mm_per_s=(100.0, 50.0, 100.0),
    acceleration_mm_per_s2=(50.0, 50.0, 50.0),
    turn_deg_per_s=20.0,
    turn_deg_per_s2=40.0,
    command_latency_s=0.25,
    touch_latency_s=0.5,
    turn_latency_s=2.0,
    carrying_s=300.0,
)


def job(stations: list[int], *, position_set: str = "S3", **timing: float) -> Job:
    settings = with_overrides(load_settings(CASE_STUDY), position_set=position_set, stations=stations)
    chosen = settings.timing.model_copy(update=timing)
    return prepare_job(settings.model_copy(update={"timing": chosen}), CASE_STUDY.parent)


# ------------------------------------------------------------------ the time model


def test_a_move_takes_what_the_slowest_axis_allows() -> None:
    # 300 mm along Y: ramps of 1 s and 25 mm to 50 mm/s, 250 mm in 5 s.
    assert MODEL.move_s((0.0, 0.0, 0.0), (0.0, 300.0, 0.0), None) == pytest.approx(7.0)
    # With a feed of 10 mm/s: ramps of 0.2 s and 1 mm each, 298 mm in 29.8 s.
    assert MODEL.move_s((0.0, 0.0, 0.0), (0.0, 300.0, 0.0), 10.0) == pytest.approx(30.2)
    assert MODEL.move_s((1.0, 2.0, 3.0), (1.0, 2.0, 3.0), None) == 0.0


def test_a_touch_ends_when_the_axes_have_braked_after_the_trip() -> None:
    way = straight_path((0.0, 0.0, 0.0), (30.0, 0.0, 0.0))
    # 10 mm/s with 50 mm/s²: 0.2 s and 1 mm up, 19 mm in 1.9 s, trip at 20 mm, 0.2 s and 1 mm to stand.
    seconds, at = MODEL.touch_s(way, 10.0, 20.0)
    assert seconds == pytest.approx(2.3)
    assert at == pytest.approx((21.0, 0.0, 0.0))
    # A miss goes to the target: 28 mm in 2.8 s between the ramps.
    seconds, at = MODEL.touch_s(way, 10.0, None)
    assert seconds == pytest.approx(3.2)
    assert at == (30.0, 0.0, 0.0)


def test_both_axes_of_the_mount_turn_at_once() -> None:
    # 90° are the longer way: 20°/s after 0.5 s and 5°, 80° in 4 s.
    assert MODEL.turn_s((0.0, 30.0), (-90.0, 60.0)) == pytest.approx(5.0)


def test_every_command_has_its_latency_and_only_carrying_takes_a_person() -> None:
    carry = OperatorRequest(OperatorTask.MOVE_ARTEFACT, "", 1)
    consent = OperatorRequest(OperatorTask.CONSENT, "")
    steps: list[Step] = [
        MoveTo("a", (0.0, 0.0, 0.0)),
        TouchTowards("b", (0.0, 0.0, 0.0), 1.0),
        OrientTo("c", 1, 0.0, 0.0),
        AskOperator("d", carry),
        AskOperator("e", consent),
    ]
    assert [MODEL.overhead_s(step) for step in steps] == [0.25, 0.5, 2.0, 300.0, 0.0]


# ------------------------------------------------------------------ walked against simulated


@pytest.fixture(scope="module")
def at_two_stations() -> Job:
    return job([1, 2], relocation_minutes=4.0)


def test_the_walk_agrees_with_the_dry_run_step_by_step(at_two_stations: Job) -> None:
    preflight = preflight_of(at_two_stations)
    _, steps = walk_plan(at_two_stations, expected_plan(calibration_of(at_two_stations)))
    touches = [sum(isinstance(timed.step, TouchTowards) for timed in walked) for walked in (steps, preflight.steps)]
    assert touches[0] == touches[1] > 300
    walked_s = np.array([timed.seconds for timed in steps if timed.seconds > 0.0])
    assert walked_s == pytest.approx(np.array([timed.seconds for timed in preflight.steps]), rel=1e-2, abs=1e-3)
    assert walked_s.sum() == pytest.approx(preflight.machine_seconds, rel=1e-6)
    assert minutes_by_part(steps)[2] == pytest.approx(minutes_by_part(preflight.steps)[2])


def test_balls_are_found_where_they_stand(at_two_stations: Job) -> None:
    position = Position(2, 30.0, 20.0)
    order = MeasuringOrder("timed", (position,), 2)
    measured, _ = walk_plan(at_two_stations, measure_positions(order, at_two_stations.layout, at_two_stations.rules))
    nominal = at_two_stations.layout.nominal(position)[measured.positions[0].ball_numbers]
    assert measured.positions[0].centres_mm == pytest.approx(nominal, abs=1e-9)
    assert measured.lost == 0


def test_the_minutes_of_a_set_add_up(at_two_stations: Job) -> None:
    minutes = machine_minutes(at_two_stations, at_two_stations.positions)
    assert list(minutes.per_position) == list(at_two_stations.positions)
    assert minutes.carrying == pytest.approx(8.0)  # nobody knows where the artefact stands at first
    assert minutes.total == pytest.approx(minutes.carrying + sum(minutes.per_position.values()))


def test_the_parts_of_the_time_are_the_time(at_two_stations: Job) -> None:
    _, steps = walk_plan(at_two_stations, expected_plan(calibration_of(at_two_stations)))
    by_station = minutes_by_part(steps)
    assert sum(sum(parts.values()) for parts in by_station.values()) == pytest.approx(
        sum(s.seconds for s in steps) / 60
    )
    # Carried to 2 and 1 to measure, in this order: then it stands already where the proof is measured.
    assert {station: parts[CARRYING] for station, parts in by_station.items()} == pytest.approx({1: 4.0, 2: 4.0})
    assert set(by_station[1]) == set(PARTS)


def test_a_latency_costs_as_many_times_as_its_command_is_given() -> None:
    quick, slow = job([1]), job([1], touch_latency_s=1.079)
    touches = sum(
        1 for timed in walk_plan(quick, expected_plan(calibration_of(quick)))[1] if isinstance(timed.step, TouchTowards)
    )
    more = machine_total(slow) - machine_total(quick)
    assert touches > 300
    assert more == pytest.approx(touches / 60.0)
    assert preflight_of(slow).machine_minutes - preflight_of(quick).machine_minutes == pytest.approx(touches / 60.0)


def machine_total(of: Job) -> float:
    return sum(timed.seconds for timed in walk_plan(of, expected_plan(calibration_of(of)))[1]) / 60.0


def test_one_position_costs_about_what_it_costs_in_a_set(at_two_stations: Job) -> None:
    """Only the way from the position before and its angles differ; to the first of a station it is from outside."""
    in_set = machine_minutes(at_two_stations, at_two_stations.positions).per_position
    alone = {position: position_minutes(at_two_stations, position) for position in in_set}
    firsts = {next(p for p in in_set if p.station == station) for station in (1, 2)}
    assert {p: alone[p] for p in in_set if p not in firsts} == pytest.approx(
        {p: in_set[p] for p in in_set if p not in firsts}, rel=0.03
    )
    assert all(alone[p] < in_set[p] < 1.2 * alone[p] for p in firsts)
    assert sum(alone.values()) == pytest.approx(sum(in_set.values()), rel=0.03)


def test_a_position_out_of_reach_takes_no_time() -> None:
    one = job([1])
    far = dataclasses.replace(one.layout, upper_mm=one.layout.lower_mm + 1.0)
    unreachable = dataclasses.replace(one, layout=far)
    position = Position(1, 45.0, 0.0)
    assert position_minutes(unreachable, position) == 0.0
    assert machine_minutes(unreachable, [position]).per_position == {position: 0.0}


def test_the_plan_says_what_the_time_is_spent_on() -> None:
    said = volcal_json("plan", "--config", CASE_STUDY, "--stations", "2")
    parts = said["minutes_by_station"]
    assert list(parts) == ["2"]
    assert list(parts["2"]) == list(PARTS)
    assert sum(parts["2"].values()) == pytest.approx(said["machine_minutes"], abs=0.003)
    page = (CASE_STUDY.parents[1] / "docs" / "reference" / "json.md").read_text(encoding="utf-8")
    described = page.split("\n## `plan`\n", 1)[1].split("\n## ", 1)[0]
    assert [key for key in (*said, *PARTS) if f"`{key}`" not in described] == []


def test_the_plan_shows_a_row_for_each_station() -> None:
    done = volcal("plan", "--config", CASE_STUDY, "--stations", "2,3")
    table = done.stdout.split("machine minutes", 1)[1].split("forecast of the gates", 1)[0]
    rows = [line.strip("│ ").split("│") for line in table.splitlines() if line.startswith("│")]
    assert [row[0].strip() for row in rows] == ["2", "3", "all"]
    figures = np.array([[float(cell) for cell in row[1:]] for row in rows])
    assert figures[:, -1] == pytest.approx(figures[:, :-1].sum(axis=1), abs=0.031)
    assert figures[2] == pytest.approx(figures[:2].sum(axis=0), abs=0.011)


def test_a_preflight_is_interrupted_at_its_next_step(at_two_stations: Job) -> None:
    looked: list[int] = []

    def watch() -> None:
        looked.append(1)
        if len(looked) == 20:
            raise Aborted("aborted: a test")

    with pytest.raises(Aborted, match="a test") as ended:
        preflight_of(at_two_stations, watch=watch)
    assert len(looked) == 20
    assert "step" not in ended.value.where
