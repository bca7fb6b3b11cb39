"""The table does not depend on how the same measurement is written down."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from benchmarks.family import AMPLITUDES
from campaigns.foreign.artefact import S3, ForeignBar, measure, straight_bar, tilted_bar
from campaigns.foreign.machine import CHAIN, GRID, RANGES, TOOL, foreign_machine
from campaigns.foreign.score import turned_about_the_bar
from twin.artefact.observations import Observations
from twin.identification import Estimate, identify, predicted_vce
from twin.machine.error_model import ErrorModel
from twin.machine.forward_model import exact_deviation
from twin.machine.kinematic_chain import parse_chain
from twin.machine.machine_population import family_from_amplitudes

ORDER = 6
SHIFT_MM = np.array([-1200.0, 5000.0, 5000.0])
BARS = {"tilted": tilted_bar, "straight": lambda rng: straight_bar(rng, 0.005)}


def estimate(seen: Observations, bar: ForeignBar, shift: np.ndarray | None = None) -> Estimate:
    moved = np.zeros(3) if shift is None else shift
    x, y, z = ((low + by, high + by) for (low, high), by in zip(RANGES, moved.tolist(), strict=True))
    family = family_from_amplitudes(ErrorModel.uniform(parse_chain(CHAIN), (x, y, z), ORDER), AMPLITUDES)
    return identify(family.model, seen, bar.artefact, family)


def field(found: Estimate, shift: np.ndarray | None = None) -> np.ndarray:
    at = GRID if shift is None else GRID + shift
    return exact_deviation(found.model, at, TOOL, found.parameters)


@pytest.fixture(scope="module", params=sorted(BARS))
def case(request: pytest.FixtureRequest) -> tuple[Observations, ForeignBar, np.ndarray]:
    rng = np.random.default_rng(11)
    machine, bar = foreign_machine(rng), BARS[request.param](rng)
    seen = measure(machine, bar, S3, rng, clamping_roll_rad=0.4).seen
    return seen, bar, field(estimate(seen, bar))


def assert_same(found: np.ndarray, before: np.ndarray) -> None:
    assert np.abs(found - before).max() < 1e-6 * np.abs(before).max()


Case = tuple[Observations, ForeignBar, np.ndarray]


def test_order_of_rows_and_numbers_of_positions(case: Case) -> None:
    seen, bar, before = case
    rng = np.random.default_rng(1)
    shuffled = seen.select(rng.permutation(seen.size))
    assert_same(field(estimate(shuffled, bar)), before)
    numbers = rng.permutation(seen.position.max() + 1)
    assert_same(field(estimate(replace(seen, position=numbers[seen.position] + 7), bar)), before)


def test_balls_relabelled(case: Case) -> None:
    seen, bar, before = case
    new = np.random.default_rng(2).permutation(len(bar.certified))
    relabelled = replace(bar, certified=bar.certified[np.argsort(new)])
    assert_same(field(estimate(replace(seen, ball=new[seen.ball]), relabelled)), before)


def test_bar_written_end_for_end(case: Case) -> None:
    """The frame is turned by half a turn about Z, which swaps the ends of the bar."""
    seen, bar, before = case
    turned = replace(bar, certified=bar.certified * np.array([-1.0, -1.0, 1.0]))
    assert_same(field(estimate(seen, turned)), before)


def test_frame_turned_about_the_bar(case: Case) -> None:
    seen, bar, before = case
    turned = replace(bar, certified=turned_about_the_bar(bar.certified, 2.1))
    assert_same(field(estimate(seen, turned)), before)


@pytest.mark.parametrize("uncertified", [(), (3, 7)])
def test_frame_turned_by_a_share_of_a_turn(uncertified: tuple[int, ...]) -> None:
    """The roll of a straight bar starts from another angle, and the shifts and tilts of its poses with it."""
    rng = np.random.default_rng([11, 1])
    machine, bar = foreign_machine(rng), replace(straight_bar(rng, 0.005), uncertified=uncertified)
    seen = measure(machine, bar, S3, rng, clamping_roll_rad=0.4).seen
    turned = replace(bar, certified=turned_about_the_bar(bar.certified, math.radians(40.0)))
    one, other = estimate(seen, bar), estimate(seen, turned)
    assert_same(field(other), field(one))
    first_um, second_um = (predicted_vce(found, GRID, TOOL).aligned_um for found in (one, other))
    assert second_um == pytest.approx(first_um, rel=1e-6)


def test_zero_of_the_axes(case: Case) -> None:
    seen, bar, before = case
    moved = replace(seen, axis_positions=seen.axis_positions + SHIFT_MM)
    found = estimate(moved, bar, SHIFT_MM)
    assert_same(field(found, SHIFT_MM), before)
    assert found.rank == estimate(seen, bar).rank
