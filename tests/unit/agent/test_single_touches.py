"""Designs out of single touches (`benchmarks.single_touches`): all touches of a ball are its centre, and the touches
that are chosen gain more per second than others, by plain inverses."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from agent.planning.case_file import load_case, shipped_case
from agent.planning.cycle_time import set_alone
from agent.planning.design.design_problem import DesignProblem
from benchmarks.single_touches import TouchRows, minutes_for
from twin.arrays import Array
from twin.design.candidates import build_candidates
from twin.machine.volumetric import evaluation_grid

FIRST_S, MORE_S, FIXED_S = 1.5, 0.9, 12.0


@cache
def problem() -> DesignProblem:
    job = load_case(shipped_case("quick").settings)
    return DesignProblem({job.settings.tool: job}, 90.0, set_alone)


@cache
def touches() -> TouchRows:
    return TouchRows.of(problem())


def information(mask: np.ndarray) -> Array:
    """Return the information (N, P, P) of each position with the touches of the mask."""
    factors = touches().candidates_with(mask).factors
    return np.asarray(factors.transpose(0, 2, 1) @ factors)


def test_three_touches_of_each_ball_are_its_centre() -> None:
    job, made = problem().job, touches().candidates
    variance = float(np.trace(job.procedure.covariance_mm2)) / 3.0
    procedure = replace(problem().procedure, covariance_mm2=variance * np.eye(3))
    grid = evaluation_grid(job.machine.model.ranges_mm)
    centres = build_candidates(
        procedure, made.positions, job.machine.family, problem().options, grid, job.tool_offset_mm
    )
    expected = centres.factors.transpose(0, 2, 1) @ centres.factors
    found = information(touches().present)
    assert np.abs(found - expected).max() < 1e-7 * np.abs(expected).max()
    assert np.array_equal(touches().alternating(3), touches().present)


def test_the_end_balls_keep_their_touches_and_each_other_ball_has_its_number() -> None:
    one = touches().alternating(1)
    balls, single = touches().omitted(one)
    counts, fixed = touches().candidates.balls, touches().fixed.sum(axis=1) // 3
    assert (fixed >= 2).all()
    assert (balls == 0).all()
    assert np.array_equal(single, 2 * (counts - fixed))
    assert np.array_equal(one.sum(axis=1), 3 * fixed + counts - fixed)


def worth(number: int, mask: np.ndarray, covariance: Array, form: Array) -> float:
    """Return the decrease of trace(Q C) per second, in which the touches of the mask are made at the position."""
    after = np.linalg.inv(np.linalg.inv(covariance) + information(mask)[number])
    touched = mask[number].reshape(-1, 3).sum(axis=1) * ~touches().fixed[number].reshape(-1, 3)[:, 0]
    seconds = FIXED_S + sum(FIRST_S + (count - 1) * MORE_S for count in touched.tolist() if count)
    return float(np.vdot(form, covariance - after)) / seconds


def test_the_chosen_touches_gain_at_least_as_much_per_second_as_all_of_them_or_those_of_the_end_balls() -> None:
    made = touches().candidates
    covariance, form = made.covariance([0, made.count // 2]), made.form.aligned
    chosen = touches().chosen(covariance, form, FIRST_S, MORE_S, np.full(made.count, FIXED_S))
    assert (chosen >= (touches().fixed & touches().present)).all()
    assert not (chosen & ~touches().present).any()
    for number in range(0, made.count, 5):
        own = worth(number, chosen, covariance, form)
        for other in (touches().present, touches().present & touches().fixed):
            assert own >= worth(number, other, covariance, form) * (1.0 - 0.02)  # the choice knows the pose to 0.3 mm


def test_the_minutes_for_an_error_lie_on_the_curve() -> None:
    assert minutes_for(3.5, (8.0, 10.0, 12.0), (4.0, 3.0, 2.5)) == pytest.approx(9.0)
    assert minutes_for(2.5, (8.0, 10.0, 12.0), (4.0, 3.0, 2.5)) == 12.0
