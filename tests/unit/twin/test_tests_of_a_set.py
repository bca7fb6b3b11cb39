"""Tests of a whole set for a step of the machine and for a pattern of shifts, compared with plain dense matrices."""

from __future__ import annotations

import math

import numpy as np
import pytest
from measured_set import TOOL, bar, case_study, measured

from twin.artefact.observations import Observations
from twin.identification import Options
from twin.identification.checks.outliers import WhitenedResiduals, studentised_residuals
from twin.identification.checks.shift_pattern import shift_patterns
from twin.identification.checks.step_in_run import step_in_run
from twin.identification.hidden_step import StepVisibility
from twin.identification.jump import ERRORS, coefficients_of
from twin.identification.problem import IdentificationProblem, build_problem
from twin.identification.solution import Solution, solve
from twin.machine.forward_model import exact_deviation
from twin.machine.volumetric import evaluation_grid, volumetric_error

MODEL, FAMILY = case_study(2)
BAR = bar(5, sigma_mm=0.8e-3)
TRUTH = FAMILY.draw(np.random.default_rng(5), 1)[0]
# ρ g L⁴ / (4 E r²) of carbon fibre, 1600 kg/m³ and 120 GPa, in SI units
SAG_MM = 1e3 * 1600.0 * 9.81 * (1e-3 * BAR.half_length_mm) ** 4 / (4.0 * 120e9 * 0.015**2)
OPTIONS = Options(outliers="none", estimate_scales=False, misfit_mm=0.0)


def seen() -> Observations:
    def deviation(at: np.ndarray, tool: np.ndarray) -> np.ndarray:
        return exact_deviation(MODEL, at, tool, TRUTH)

    return measured("S1", 2, BAR, deviation, np.random.default_rng(3), sigma_mm=1e-3)


@pytest.fixture(scope="module")
def problem() -> IdentificationProblem:
    return build_problem(FAMILY, seen(), BAR, OPTIONS)


@pytest.fixture(scope="module")
def solution(problem: IdentificationProblem) -> Solution:
    return solve(problem, OPTIONS, "centres")


@pytest.fixture(scope="module")
def residuals(solution: Solution) -> WhitenedResiduals:
    return studentised_residuals(solution)


class Dense:
    """Everything written out in mm, with the poses removed by their null space: y = A z + noise."""

    def __init__(self, problem: IdentificationProblem, solution: Solution) -> None:
        self.problem, n = problem, problem.observations.size
        points, _ = solution.sides
        free = np.zeros((n, 3, 0))
        for k in range(problem.layout.positions):
            there = problem.layout.index == k
            motions = np.zeros((n, 3, 6))
            motions[there, :, :3] = np.eye(3)
            for axis in range(3):
                levers = points[there] - points[there].mean(axis=0)
                motions[there, :, 3 + axis] = np.cross(np.eye(3)[axis], levers) / 500.0
            free = np.concatenate((free, motions), axis=2)
        flat = free.reshape(3 * n, -1)
        self.beside = np.linalg.svd(flat)[0][:, flat.shape[1] :]
        self.design = problem.layout.unpad(problem.design).reshape(3 * n, -1)
        left, local = solution.sides
        rest = (left - solution.poses.to_workpiece(problem.layout, local)).reshape(-1)
        self.y = self.beside.T @ (self.design @ solution.z - rest)
        rows = self.beside.T @ self.design
        self.covariance = 1e-6 * np.eye(len(self.y)) + rows @ rows.T

    def log_ratio(self, columns: np.ndarray, scale: float) -> float:
        """Log likelihood of y with further unknowns of unit variance and these effects (n, 3, m), against none."""
        effects = self.beside.T @ columns.reshape(len(self.beside), -1)
        without = scale * self.covariance
        return self._log_density(without + effects @ effects.T) - self._log_density(without)

    def _log_density(self, covariance: np.ndarray) -> float:
        _, determinant = np.linalg.slogdet(covariance)
        return -0.5 * (float(self.y @ np.linalg.solve(covariance, self.y)) + float(determinant))


def log_mean(logs: list[float]) -> float:
    return float(np.logaddexp.reduce(logs)) - math.log(len(logs))


def test_the_ratio_of_a_step_is_that_of_both_densities(
    problem: IdentificationProblem, solution: Solution, residuals: WhitenedResiduals
) -> None:
    dense, n = Dense(problem, solution), problem.observations.size
    design = dense.design.reshape(n, 3, -1)
    found = step_in_run(solution, residuals, np.arange(n), TOOL)
    ratios: dict[tuple[str, int], float] = {}
    for error in ERRORS:
        columns = design[:, :, coefficients_of(problem.unknowns, error)]
        for instant in range(n):
            after = (np.arange(n) >= instant)[:, None, None]
            ratios[error, instant] = dense.log_ratio(columns * after, residuals.scale)
    within = log_mean([ratio for (_, instant), ratio in ratios.items() if instant])
    before = log_mean([ratio for (_, instant), ratio in ratios.items() if not instant])
    assert found.log_ratio == pytest.approx(within - max(before, 0.0), abs=1e-2)
    likeliest = max((key for key in ratios if key[1]), key=lambda key: ratios[key])
    assert found.suspects[0].jump.error == likeliest[0]
    assert found.suspects[0].jump.evidence == pytest.approx(ratios[likeliest], abs=1e-2)


def test_the_ratio_of_a_pattern_is_that_of_both_densities(
    problem: IdentificationProblem, solution: Solution, residuals: WhitenedResiduals
) -> None:
    dense, observed = Dense(problem, solution), problem.observations
    found = shift_patterns(problem, residuals, np.arange(observed.size))
    place = np.concatenate([np.arange(count) for count in problem.layout.counts])
    logs = list[float]()
    moved = np.diff(observed.axis_positions, axis=0, prepend=observed.axis_positions[:1])
    for axis in range(3):
        shares: list[np.ndarray] = [place >= first for first in range(1, place.max() + 1)]
        for other, (low, high) in enumerate(MODEL.ranges_mm):
            shares += [observed.axis_positions[:, other] > low + 0.1 * k * (high - low) for k in range(1, 10)]
        shares.append(0.5 * np.sign(moved[:, axis]) * (np.abs(moved[:, axis]) > 0.5))
        logs += [dense.log_ratio(0.005 * np.outer(share, np.eye(3)[axis]), residuals.scale) for share in shares]
    along = problem.poses.rotation[problem.layout.index][:, :, 0]
    down = along * along[:, 2:] - np.array([0.0, 0.0, 1.0])
    share = np.abs(BAR.balls[observed.ball, 0]) / BAR.half_length_mm
    hanging = (share**4 - 4.0 * share**3 + 6.0 * share**2) / 3.0
    logs.append(dense.log_ratio(SAG_MM * hanging[:, None] * down, residuals.scale))
    assert found.log_ratio == pytest.approx(log_mean(logs), abs=1e-2)


def test_a_hidden_step_is_what_a_refit_leaves(problem: IdentificationProblem, solution: Solution) -> None:
    """The step is added to the measured points after its instant, and everything is estimated again."""
    visibility = StepVisibility.planned(FAMILY, BAR, problem.observations, OPTIONS, TOOL)
    hidden = visibility.largest_in_order(range(problem.layout.positions))
    assert hidden is not None
    assert hidden.between is not None
    columns = coefficients_of(problem.unknowns, hidden.error)
    after = problem.layout.index >= hidden.between[1]
    grid = evaluation_grid(MODEL.ranges_mm)
    dense = Dense(problem, solution)
    rows = dense.beside.T @ dense.design
    gain = rows.T @ np.linalg.inv(dense.covariance)
    squares = []
    for column in columns:
        effect = dense.design.reshape(-1, 3, rows.shape[1])[:, :, column] * after[:, None]
        shift = gain @ (dense.beside.T @ effect.reshape(-1))
        step = np.zeros(MODEL.size)
        step[column] = 1.0
        both = (shift[: MODEL.size], step - shift[: MODEL.size])
        fields = [exact_deviation(MODEL, grid, TOOL, 1e-3 * problem.unknowns.scale * one) for one in both]
        squares.append([1e6 * volumetric_error(grid + TOOL, field).aligned_mm ** 2 for field in fields])
    left_mm = math.sqrt(np.sum(squares, axis=0).min())
    # the shape of the family: each coefficient by the same multiple of its standard deviation
    multiple = hidden.vce_um / (1e3 * left_mm)
    parameters = [problem.unknowns.model.parameters[i] for i in columns]
    unit = 1e3 if parameters[0].unit == "mm" else 1e6
    shares = np.array([1.0 / (2.0 * one.order + 1.0) for one in parameters])
    change = unit * multiple * math.sqrt(float(shares @ problem.unknowns.scale[columns] ** 2))
    assert hidden.change == pytest.approx(change, rel=0.02)


def test_fewer_positions_hide_as_if_they_had_been_planned_alone(problem: IdentificationProblem) -> None:
    observed = problem.observations
    whole = StepVisibility.planned(FAMILY, BAR, observed, OPTIONS, TOOL)
    alone = StepVisibility.planned(FAMILY, BAR, observed.select(observed.position < 4), OPTIONS, TOOL)
    expected, found = alone.largest_in_order(range(4)), whole.restricted_to(range(4)).largest_in_order(range(4))
    assert expected is not None
    assert found is not None
    assert (found.error, found.between) == (expected.error, expected.between)
    assert found.vce_um == pytest.approx(expected.vce_um, rel=1e-6)
