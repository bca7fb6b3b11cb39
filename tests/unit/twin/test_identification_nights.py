"""Fusion of nights: a carried-over estimate against one fit of all nights, and against a random walk in dense algebra.

Truth and noise are a thousandth of their stated size, so second-order effects vanish and both methods differ only by
rounding. Errors of realistic size are compared as well.
"""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest
from measured_set import TOOL, bar, case_study, measured

from twin.artefact.artefact import Artefact
from twin.artefact.observations import Observations
from twin.errors import DataError
from twin.identification import CarriedOverPrior, Estimate, Options, Scales, identify, process_noise
from twin.machine.forward_model import deviation_basis, exact_deviation
from twin.machine.volumetric import evaluation_grid, volumetric_error

MODEL, FAMILY = case_study(3)
SIGMA = FAMILY.prior_standard_deviation
FIXED = Options(estimate_scales=False, outliers="none", temperature_standard_uncertainty_k=0.1)
STEEL = bar(7, sigma_mm=0.8e-3, cte_standard_uncertainty_per_k=1e-6)
BOTH_TOOLS = (TOOL, np.array([60.0, 330.0, -40.0]))


def a_night(expression: str, artefact: Artefact, seed: int, size: float, **more: Any) -> Observations:
    """Return one night of one machine: a family member plus a wave that no order represents, scaled by `size`."""
    truth = size * FAMILY.draw(np.random.default_rng(5), 1)[0]

    def deviation(at: np.ndarray, tool: np.ndarray) -> np.ndarray:
        return exact_deviation(MODEL, at, tool, truth) + size * 1e-3 * np.sin(at[:, [1, 2, 0]] / 150.0)

    rng = np.random.default_rng(seed)
    seen = measured(expression, 2, artefact, deviation, rng, sigma_mm=size * 1e-3, **more)
    return dataclasses.replace(seen, covariance=np.tile(np.eye(3) * 1e-6, (seen.size, 1, 1)))


def together(first: Observations, second: Observations, second_ball: int = 0) -> Observations:
    names = ("tool", "axis_positions", "covariance", "temperature_c", "elevation_rad")
    joined = {name: np.concatenate((getattr(first, name), getattr(second, name))) for name in names}
    position = np.concatenate((first.position, second.position + 100))
    ball = np.concatenate((first.ball, second.ball + second_ball))
    return Observations(position=position, ball=ball, tool_offsets=first.tool_offsets, **joined)


def in_turn(nights: list[Observations], artefact: Artefact, options: Options = FIXED) -> Estimate:
    estimate = identify(MODEL, nights[0], artefact, FAMILY, options)
    for seen in nights[1:]:
        carried = dataclasses.replace(options, carried_over=estimate.carried_over())
        estimate = identify(MODEL, seen, artefact, FAMILY, carried)
    return estimate


def test_two_nights_of_a_sagging_bar_are_one_fit_of_both() -> None:
    sagging = dataclasses.replace(STEEL, sag_standard_uncertainty_mm=2e-5)
    first, second = a_night("S3", sagging, 0, 1e-3), a_night("S2", sagging, 1, 1e-3)
    assert_same(
        in_turn([first, second], sagging), identify(MODEL, together(first, second), sagging, FAMILY, FIXED), 1e-6
    )


def assert_same(one: Estimate, other: Estimate, accuracy: float) -> None:
    assert one.z == pytest.approx(other.z, abs=accuracy)
    assert one.parameters / SIGMA == pytest.approx(other.parameters / SIGMA, abs=accuracy)
    assert one.z_covariance == pytest.approx(other.z_covariance, abs=1e-10)


@pytest.mark.parametrize(("size", "accuracy"), [(1e-3, 1e-9), (1.0, 1e-5)])
def test_two_nights_in_turn_are_one_fit_of_both(size: float, accuracy: float) -> None:
    """Certificate, CTE, thermometer and misfit are common to both nights; 26 °C in the second makes the CTE matter."""
    first = a_night("S1", STEEL, 1, size)
    second = a_night("S3", STEEL, 2, size, temperature_c=26.0)
    at_once = identify(MODEL, together(first, second), STEEL, FAMILY, FIXED)
    fused = in_turn([first, second], STEEL)
    assert np.abs(fused.z).max() > 0.3 * size
    assert_same(fused, at_once, accuracy)


def test_three_nights_with_two_tools_are_one_fit_of_all() -> None:
    """The first tool measures most balls in the first night and overall, because the misfit is defined for that
    tool."""
    nights = [a_night(name, STEEL, seed, 1e-3, tools=BOTH_TOOLS) for seed, name in enumerate(("S3", "S2", "S1"))]
    at_once = identify(MODEL, together(together(nights[0], nights[1]), _later(nights[2])), STEEL, FAMILY, FIXED)
    assert_same(in_turn(nights, STEEL), at_once, 1e-9)


def _later(seen: Observations) -> Observations:
    return dataclasses.replace(seen, position=seen.position + 100)


def test_another_artefact_brings_errors_of_its_own() -> None:
    """Equivalent to one artefact with the balls of both, of which the second night measures the second half."""
    one, other = bar(7, sigma_mm=0.8e-3), bar(5, 20.0, sigma_mm=0.5e-3)
    first, second = a_night("S1", one, 3, 1e-3), a_night("S3", other, 4, 1e-3)
    moved = other.balls + np.array([0.0, 4000.0, 0.0])
    covariance = np.diag(np.concatenate((np.diagonal(one.covariance), np.diagonal(other.covariance))))
    both = dataclasses.replace(one, balls=np.concatenate((one.balls, moved)), covariance=covariance)
    options = dataclasses.replace(FIXED, temperature_standard_uncertainty_k=0.0)
    at_once = identify(MODEL, together(first, second, 7), both, FAMILY, options)
    known = identify(MODEL, first, one, FAMILY, options).carried_over()
    fused = identify(MODEL, second, other, FAMILY, dataclasses.replace(options, carried_over=known))
    assert fused.parameters / SIGMA == pytest.approx(at_once.parameters / SIGMA, abs=1e-9)
    assert fused.misfit is not None
    assert at_once.misfit is not None
    assert fused.misfit.coefficients == pytest.approx(at_once.misfit.coefficients, abs=1e-9)
    assert fused.covariance / np.outer(SIGMA, SIGMA) == pytest.approx(
        at_once.covariance / np.outer(SIGMA, SIGMA), abs=1e-6
    )


def test_with_process_noise_it_is_the_fit_of_a_random_walk() -> None:
    """Dense reference: parameters of both nights, certificate and all poses in one matrix, coupled by a difference
    prior."""
    artefact = bar(7, sigma_mm=0.8e-3)
    options = dataclasses.replace(FIXED, misfit_mm=0.0, temperature_standard_uncertainty_k=0.0)
    nights = [a_night("S1", artefact, 6, 1e-3), a_night("S3", artefact, 7, 1e-3)]
    walk = SIGMA * np.linspace(0.1, 0.6, MODEL.size)
    known = identify(MODEL, nights[0], artefact, FAMILY, options).carried_over(walk, nights=2.0)
    fused = identify(MODEL, nights[1], artefact, FAMILY, dataclasses.replace(options, carried_over=known))
    parameters, covariance = random_walk(nights, artefact, np.sqrt(2.0) * walk)
    assert fused.parameters / SIGMA == pytest.approx(parameters / SIGMA, abs=2e-9)
    unit = np.outer(SIGMA, SIGMA)
    assert fused.covariance / unit == pytest.approx(covariance / unit, abs=1e-6)
    still = in_turn(nights, artefact, options)
    assert (fused.standard_uncertainty > still.standard_uncertainty).all()


def random_walk(nights: list[Observations], artefact: Artefact, walk: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the parameters (p,) of the second night and their covariance (p, p) from one dense least-squares fit."""
    p, balls = MODEL.size, artefact.count
    places = [len(np.unique(seen.position)) for seen in nights]
    width = 2 * p + 3 * balls + 6 * sum(places)
    rows, right = [], []
    for number, seen in enumerate(nights):
        basis, points = deviation_basis(MODEL, seen.axis_positions, TOOL), seen.axis_positions + TOOL
        for k, position in enumerate(np.unique(seen.position)):
            here = np.flatnonzero(seen.position == position)
            nominal, middle = artefact.balls[seen.ball[here]], points[here].mean(axis=0)
            turn, placed = kabsch(nominal, points[here])
            at = 2 * p + 3 * balls + 6 * (sum(places[:number]) + k)
            for row, ball, where in zip(here, seen.ball[here], placed, strict=True):
                block = np.zeros((3, width))
                block[:, number * p : number * p + p] = basis[row]
                block[:, 2 * p + 3 * ball : 2 * p + 3 * ball + 3] = -turn
                block[:, at : at + 3] = -np.eye(3)
                block[:, at + 3 : at + 6] = -np.cross(np.eye(3), where - middle).T / 500.0
                rows.append(block / 1e-3)
                right.append((where - points[row]) / 1e-3)
    prior = np.zeros((2 * p + 3 * balls, width))
    prior[:p, :p] = np.diag(1.0 / SIGMA)
    prior[p : 2 * p, :p], prior[p : 2 * p, p : 2 * p] = -np.diag(1.0 / walk), np.diag(1.0 / walk)
    prior[2 * p :, 2 * p : 2 * p + 3 * balls] = np.eye(3 * balls) / 0.8e-3
    design = np.concatenate((*rows, prior))
    target = np.concatenate((*right, np.zeros(len(prior))))
    unit = np.concatenate((SIGMA, SIGMA, np.full(width - 2 * p, 1e-3)))
    left, values, rotated = np.linalg.svd(design * unit, full_matrices=False)
    solved = unit * (rotated.T @ ((left.T @ target) / values))
    covariance = (rotated.T / values**2) @ rotated * np.outer(unit, unit)
    return solved[p : 2 * p], covariance[p : 2 * p, p : 2 * p]


def kabsch(nominal: np.ndarray, found: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the rotation (3, 3) of nominal points (n, 3) onto measured ones, and the fitted points (n, 3)."""
    here, there = nominal - nominal.mean(axis=0), found - found.mean(axis=0)
    left, _, right = np.linalg.svd(here.T @ there)
    turn = right.T @ np.diag([1.0, 1.0, np.sign(np.linalg.det(left @ right))]) @ left.T
    return turn, here @ turn.T + found.mean(axis=0)


def test_noise_of_the_second_night_is_judged_by_itself() -> None:
    first = a_night("S3", STEEL, 8, 1.0)
    second = a_night("S3", STEEL, 9, 1.0)
    noisy = dataclasses.replace(second, covariance=second.covariance / 9.0)
    known = identify(MODEL, first, STEEL, FAMILY).carried_over()
    fused = identify(MODEL, noisy, STEEL, FAMILY, Options(carried_over=known))
    assert fused.scales.noise == pytest.approx(3.0, rel=0.15)
    assert (fused.scales.prior, fused.scales.misfit) == (known.scales.prior, known.scales.misfit)


def test_a_gross_error_stands_out_against_what_is_carried_over() -> None:
    first, second = a_night("S3", STEEL, 10, 1.0), a_night("S2", STEEL, 11, 1.0)
    spoilt = second.axis_positions.copy()
    spoilt[4] += [0.0, 0.03, 0.0]
    known = identify(MODEL, first, STEEL, FAMILY).carried_over()
    seen = dataclasses.replace(second, axis_positions=spoilt)
    fused = identify(MODEL, seen, STEEL, FAMILY, Options(carried_over=known))
    assert fused.rejected == ((int(second.position[4]), int(second.ball[4]), 0),)


def test_process_noise_is_a_share_of_the_family() -> None:
    walk = process_noise(FAMILY, 0.5e-3, TOOL)
    assert np.ptp(walk / SIGMA) < 1e-12
    grid = evaluation_grid(MODEL.ranges_mm, (20, 10, 10))
    basis = deviation_basis(MODEL, grid, TOOL)
    draws = np.random.default_rng(12).normal(size=(300, MODEL.size)) * walk
    squares = [volumetric_error(grid + TOOL, basis @ draw).aligned_mm ** 2 for draw in draws]
    assert np.sqrt(np.mean(squares)) == pytest.approx(0.5e-3, rel=0.05)


class TestWhatCannotBeCarried:
    known = identify(MODEL, a_night("S3", STEEL, 13, 1.0), STEEL, FAMILY, FIXED).carried_over()

    def changed(self, row: int, column: int, value: float) -> np.ndarray:
        covariance = self.known.covariance.copy()
        covariance[row, column] = value
        return covariance

    @pytest.mark.parametrize(
        ("row", "column", "value", "words", "unknown"),
        [
            (3, 3, -1.0, "singular or indefinite", MODEL.names[3]),
            (2, 2, 0.0, "singular or indefinite", MODEL.names[2]),
            (3, 5, 0.7, "not symmetric", MODEL.names[3]),
        ],
    )
    def test_no_covariance(self, row: int, column: int, value: float, words: str, unknown: str) -> None:
        with pytest.raises(DataError, match=words) as caught:
            CarriedOverPrior(self.known.unknowns, self.known.mean, self.changed(row, column, value), Scales())
        assert caught.value.where["unknown"] == unknown

    def test_a_singular_covariance_names_where_it_becomes_so(self) -> None:
        """Two identical unknowns: the second one makes the covariance singular."""
        covariance = self.known.covariance.copy()
        covariance[MODEL.size + 4], covariance[:, MODEL.size + 4] = covariance[1], covariance[:, 1]
        covariance[MODEL.size + 4, MODEL.size + 4] = covariance[1, 1] * (1.0 - 1e-12)
        with pytest.raises(DataError) as caught:
            CarriedOverPrior(self.known.unknowns, self.known.mean, covariance, Scales())
        assert caught.value.where["unknown"] == "certificate 4"

    def test_the_wrong_size(self) -> None:
        with pytest.raises(DataError, match="finite"):
            CarriedOverPrior(self.known.unknowns, self.known.mean, np.eye(3), Scales())

    def test_to_another_model(self) -> None:
        model, family = case_study(4)
        with pytest.raises(DataError, match="another model"):
            identify(model, a_night("S3", STEEL, 14, 1.0), STEEL, family, Options(carried_over=self.known))

    @pytest.mark.parametrize("change", [{"use_prior": False}, {"weights": "unit"}, {"prior_standard_deviation": SIGMA}])
    def test_with_options_that_contradict_it(self, change: dict) -> None:
        with pytest.raises(DataError, match=r"carrying over an estimate|carried-over estimate"):
            Options(carried_over=self.known, **change)

    def test_negative_process_noise(self) -> None:
        with pytest.raises(DataError, match="negative"):
            self.known.after(-SIGMA)
        with pytest.raises(DataError, match="nights"):
            self.known.after(SIGMA, -1.0)
        with pytest.raises(DataError, match="negative"):
            process_noise(FAMILY, -1e-3, TOOL)
