"""Machine minutes of candidate positions: computed for some of them, estimated for the others; and the sequence in
which a sequential calibration of a machine of its family would measure them."""

from __future__ import annotations

from functools import cache
from itertools import islice

import numpy as np
import pytest
from study_case import shipped_job

from agent.planning.design import feasibility
from agent.planning.design.feasibility import FeasibilityCheck, timed_among
from agent.planning.design.sequential_candidates import LEAST_CARRY_MIN, SequentialCandidates, standing_in
from twin.artefact.position_set import Position
from twin.design.candidates import Indices
from twin.units import S_PER_MIN

GRID = tuple(
    Position(1, azimuth, elevation) for azimuth in (-90.0, 0.0, 60.0) for elevation in (-60.0, 0.0, 45.0, 75.0)
)


def balls_of(positions: tuple[Position, ...]) -> Indices:
    layout = shipped_job(2).layout
    return np.array([int(layout.reachable(one, layout.nominal(one)).sum()) for one in positions])


def measurable() -> tuple[Position, ...]:
    return tuple(one for one, balls in zip(GRID, balls_of(GRID), strict=True) if balls >= 3)


def test_the_minutes_of_few_positions_are_those_of_their_plans() -> None:
    check, few = FeasibilityCheck(shipped_job(2)), measurable()[:4]
    exact = [check.minutes(position) for position in few]
    assert check.estimated_minutes(few, balls_of(few)) == pytest.approx(exact, rel=1e-12)


def test_of_many_positions_some_are_computed_and_the_others_are_near(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(feasibility, "_TIMED", 5)
    check, many = FeasibilityCheck(shipped_job(2)), measurable()
    assert len(many) > 6
    estimated = check.estimated_minutes(many, balls_of(many))
    computed = len(check._minutes)
    exact = np.array([check.minutes(position) for position in many])
    timed = timed_among(len(many))
    assert computed <= len(timed) == 5
    assert estimated[timed] == pytest.approx(exact[timed], rel=1e-12)
    turns = np.array([check.turn_minutes(position) for position in many])
    assert (estimated - turns >= (exact - turns)[timed].min() - 1e-12).all()
    assert estimated == pytest.approx(exact, rel=0.2)


@cache
def candidates() -> SequentialCandidates:
    return SequentialCandidates(shipped_job(2), count=10, grid_deg=45.0)


def test_the_sequence_takes_the_largest_decrease_of_the_error_per_second_at_each_step() -> None:
    found = candidates()
    form, chosen, standing = found.nothing_seen().model.candidates, list[int](), None
    for position in islice(found.sequence(None), 5):
        seconds = found.seconds(standing, LEAST_CARRY_MIN)
        here = form.vce(chosen).aligned_mm ** 2
        worth = [
            -1.0 if index in chosen else (here - form.vce([*chosen, index]).aligned_mm ** 2) / seconds[index]
            for index in range(form.count)
        ]
        index = found.positions.index(position)
        assert worth[index] == pytest.approx(max(worth), rel=1e-6)
        chosen.append(index)
        standing = standing_in(position)


def test_a_sequence_contains_each_candidate_once_and_a_planned_one_ends_with_its_time() -> None:
    found = candidates()
    every = tuple(found.sequence(None))
    assert sorted(every, key=found.positions.index) == list(found.positions)
    seconds, standing = 0.0, None
    for position in every[:3]:
        seconds += float(found.seconds(standing)[found.positions.index(position)])
        standing = standing_in(position)
    minutes = seconds / S_PER_MIN + max(found.tail_minutes(station) for station in (1, 2))
    planned = found.planned(minutes + 1e-6, None)
    assert planned[:3] == every[:3]
    assert found.planned(0.5 * found.tail_minutes(1), None) == ()
