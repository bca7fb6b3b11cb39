"""Choice of the next position from measured ones: information that adds up, gains, and scales of the machine itself."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from agent.planning.case_file import CASE_STUDY, load_case
from agent.planning.job import Job
from twin.artefact.observations import Observations
from twin.artefact.position_set import Position
from twin.design.sequential import MIN_FOR_SCALES, OrderModel, PositionsSeen, ranked_choices
from twin.identification import Options, identify
from twin.identification.roll import build_measured_problem
from twin.identification.solution import normal_equations
from twin.machine.volumetric import evaluation_grid
from twin.uncertainty.random_machines import draw_random_machine

OPTIONS = Options(temperature_standard_uncertainty_k=0.1)
ORDERS = (5, 7)
ORIENTATIONS = ((0.0, 0.0), (90.0, 0.0), (0.0, 60.0), (-60.0, -30.0), (30.0, 30.0), (120.0, -60.0))


@cache
def job() -> Job:
    return load_case(CASE_STUDY, stations=2)


@cache
def nothing() -> PositionsSeen:
    positions = [Position(station, *angles) for station in (1, 2) for angles in ORIENTATIONS]
    grid = evaluation_grid(job().machine.model.ranges_mm, (6, 4, 4))
    models = [
        OrderModel.build(order, job().machine.with_order(order).family, job().procedure, positions, OPTIONS, grid)
        for order in ORDERS
    ]
    return PositionsSeen.none(models, job().artefact, OPTIONS, order=5)


@cache
def measured(noise: float = 1.0) -> Observations:
    """All candidates, measured on a machine whose touches scatter `noise` times as stated."""
    rng = np.random.default_rng(3)
    machine = replace(draw_random_machine(job().machine, job().tool_offset_mm, "rails", rng), noise=noise)
    planned = job().procedure.plan(nothing().model.candidates.positions).observations
    return machine.measure(planned, job().artefact, rng)


def after(count: int, noise: float = 1.0) -> PositionsSeen:
    seen = nothing()
    for number in range(count):
        seen = seen.after(measured(noise).select(measured(noise).position == number))
    return seen


def everything(seen: PositionsSeen) -> np.ndarray:
    return np.ones(seen.model.candidates.count, dtype=bool)


def test_equations_of_single_positions_add_up_to_those_of_all() -> None:
    together = measured().select(measured().position < 6)
    family = job().machine.with_order(5).family
    whole = normal_equations(build_measured_problem(family, together, job().artefact, OPTIONS))
    added = after(6).normals[0]
    assert added.rows == whole.rows
    size = np.sqrt(np.multiply.outer(np.diagonal(whole.matrix), np.diagonal(whole.matrix)))
    # the roll of a straight bar is estimated from one position here, and from all of them there
    assert np.abs(added.matrix - whole.matrix).max() < 1e-4 * size.max()


def test_the_posterior_is_that_of_the_whole_identification() -> None:
    seen = after(8)
    together = measured().select(measured().position < 8)
    options = replace(OPTIONS, outliers="none")
    family = job().machine.with_order(seen.model.order).family
    estimate = identify(family.model, together, job().artefact, family, options)
    assert np.log(seen.scales.values) == pytest.approx(np.log(estimate.scales.values), abs=0.1)
    form = seen.model.form.aligned
    assert np.vdot(form, seen.covariance) == pytest.approx(np.vdot(form, estimate.z_covariance), rel=0.25)


def test_the_gain_of_a_candidate_is_the_decrease_after_it_was_measured() -> None:
    seen = nothing()
    gains = seen.gains(everything(seen))
    form = seen.model.form.aligned
    for index in (0, 4, 9):
        left = np.vdot(form, seen.covariance) - np.vdot(form, seen.planned(index).covariance)
        assert gains[index] == pytest.approx(left, rel=1e-6)


def test_scales_and_order_are_those_stated_until_enough_was_seen() -> None:
    early, late = after(MIN_FOR_SCALES - 1), after(MIN_FOR_SCALES)
    assert set(early.scales.values) == {1.0}
    assert early.model.order == 5
    assert len(set(late.scales.values)) > 1


def test_touches_that_scatter_more_are_found_to_do_so() -> None:
    assert after(8).scales.noise < 1.7
    assert after(8, noise=4.0).scales.noise > 2.5
    assert after(8, noise=4.0).expected_vce_mm > after(8).expected_vce_mm


def test_choices_are_ranked_by_gain_per_second() -> None:
    seen = after(4)
    allowed = everything(seen)
    allowed[:4] = False
    seconds = np.full(len(allowed), 100.0)
    ranked = ranked_choices(seen, seconds, allowed).tolist()
    gains = seen.gains(allowed)
    assert sorted(ranked) == list(range(4, len(allowed)))
    assert gains[ranked].tolist() == sorted(gains[4:].tolist(), reverse=True)
    seconds[ranked[0]] = 1e6
    assert ranked_choices(seen, seconds, allowed)[-1] == ranked[0]


def test_the_posterior_of_an_identification_takes_the_place_of_the_sum() -> None:
    seen = after(8)
    together = measured().select(measured().position < 8)
    family = job().machine.with_order(5).family
    estimate = identify(family.model, together, job().artefact, family, OPTIONS)
    known = seen.with_estimate(estimate)
    assert known.model.order == 5
    assert known.covariance is estimate.z_covariance
    assert known.after(measured().select(measured().position == 8)).estimate is None
    other = replace(estimate, z=estimate.z[:-1])
    assert seen.with_estimate(other) is seen
