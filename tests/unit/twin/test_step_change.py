"""Jumps found by the score test, compared with plain dense matrices, and positions that discriminate between jumps."""

from __future__ import annotations

import numpy as np
import pytest
from measured_set import TOOL, bar, case_study, measured
from scipy.special import chdtrc

from twin.artefact.observations import Observations
from twin.identification import Estimate, Options, identify, predicted_vce
from twin.identification.jump import ERRORS
from twin.identification.problem import build_problem
from twin.machine.forward_model import deviation_basis, exact_deviation
from twin.machine.volumetric import evaluation_grid, volumetric_error
from twin.monitoring.discriminating_positions import JumpQuestions
from twin.monitoring.residual_with_active_table import ResidualWithTable, residual_covariance, uncompensated
from twin.monitoring.step_detection import innovation

MODEL, FAMILY = case_study(3)
SIGMA = FAMILY.prior_standard_deviation
BAR = bar(7, sigma_mm=0.8e-3)
TRUTH = FAMILY.draw(np.random.default_rng(5), 1)[0]


def seen(expression: str, seed: int, jump: dict[str, float] | None = None, sigma_mm: float = 1e-3) -> Observations:
    truth = TRUTH.copy()
    for name, value in (jump or {}).items():
        truth[MODEL.index(name)] += value
    rng = np.random.default_rng(seed)

    def deviation(at: np.ndarray, tool: np.ndarray) -> np.ndarray:
        return exact_deviation(MODEL, at, tool, truth)

    return measured(expression, 2, BAR, deviation, rng, sigma_mm=sigma_mm)


@pytest.fixture(scope="module")
def first() -> Estimate:
    return identify(
        MODEL, seen("S1+S2+S3", 1), BAR, FAMILY, Options(outliers="none", misfit_mm=0.0002, estimate_scales=False)
    )


def test_it_is_the_dense_normal_distribution_of_what_is_measured(first: Estimate) -> None:
    """Write everything out: mm, no whitening, the poses removed by their null space."""
    known = first.carried_over(0.1 * SIGMA, 2.0)
    later = seen("S3", 2)
    found = innovation(FAMILY, later, BAR, known)
    problem = build_problem(FAMILY, later, BAR, Options(carried_over=known, outliers="none", estimate_scales=False))
    design = problem.layout.unpad(problem.design).reshape(3 * later.size, -1)
    points, local = problem.sides(known.mean)
    left, free = [], np.zeros((3 * later.size, 0))
    for k in np.unique(problem.observations.position):
        seen_there = np.flatnonzero(problem.observations.position == k)
        left.append(points[seen_there] - placed(local[seen_there], points[seen_there]))
        motions = np.zeros((later.size, 3, 6))
        motions[seen_there, :, :3] = np.eye(3)
        for axis in range(3):
            levers = points[seen_there] - points[seen_there].mean(axis=0)
            motions[seen_there, :, 3 + axis] = np.cross(np.eye(3)[axis], levers) / 500.0
        free = np.concatenate((free, motions.reshape(-1, 6)), axis=1)
    beside = np.linalg.svd(free)[0][:, free.shape[1] :]
    residual = -beside.T @ np.concatenate(left).reshape(-1)
    rows = beside.T @ design
    noise = known.scales.noise**2 * beside.T @ np.kron(np.eye(later.size), later.covariance[0]) @ beside
    inverse = np.linalg.inv(noise + rows @ known.covariance @ rows.T)
    assert found.rows == len(residual)
    assert found.chi2 == pytest.approx(float(residual @ inverse @ residual), rel=1e-4)
    score = rows.T @ inverse @ residual
    assert found.score == pytest.approx(score, abs=1e-3 * np.abs(score).max())
    information = rows.T @ inverse @ rows
    assert found.information == pytest.approx(information, abs=1e-4 * information.max())


def placed(local: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Return artefact points in their best placement (Kabsch)."""
    u, _, vt = np.linalg.svd((points - points.mean(axis=0)).T @ (local - local.mean(axis=0)))
    rotation = u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt
    return (local - local.mean(axis=0)) @ rotation.T + points.mean(axis=0)


def test_what_is_known_after_is_what_an_identification_knows(first: Estimate) -> None:
    known = first.carried_over(0.1 * SIGMA)
    later = seen("S3", 3)
    found = innovation(FAMILY, later, BAR, known)
    fused = identify(MODEL, later, BAR, FAMILY, Options(carried_over=known, outliers="none", estimate_scales=False))
    assert found.posterior_mean == pytest.approx(fused.z, abs=1e-4)
    assert found.posterior_covariance == pytest.approx(fused.z_covariance, abs=1e-7)


@pytest.mark.parametrize(
    ("name", "jump", "unit"),
    [("B0Z", 12e-6, "µrad"), ("A0Z", -10e-6, "µrad"), ("EXX[1]", 8e-3, "µm"), ("EYX[2]", 7e-3, "µm")],
)
def test_a_jump_is_named_with_its_size(first: Estimate, name: str, jump: float, unit: str) -> None:
    known = first.carried_over(0.02 * SIGMA)
    error = name.split("[", maxsplit=1)[0]
    quiet = innovation(FAMILY, seen("S3", 4), BAR, known)
    assert quiet.find_jumps(6.0) == ()
    found = innovation(FAMILY, seen("S3", 4, {name: jump}), BAR, known)
    named = found.find_jumps(6.0)[0]
    assert (named.error, named.unit) == (error, unit)
    assert named.coefficients[name] == pytest.approx(jump, rel=0.35)
    assert np.sign(named.change) == np.sign(jump) or error == "EYX"
    assert chdtrc(named.freedom, named.chi2) < 1e-4
    assert error in named.text
    assert len(found.suspects()) == len(ERRORS)


def test_two_jumps_are_named_one_after_the_other(first: Estimate) -> None:
    known = first.carried_over(0.02 * SIGMA)
    found = innovation(FAMILY, seen("S1+S2+S3", 6, {"B0Z": 14e-6, "C0Y": -14e-6}), BAR, known)
    named = found.find_jumps(5.0)
    assert {one.error for one in named[:2]} == {"B0Z", "C0Y"}
    assert named[0].evidence > named[1].evidence


def test_chi2_of_a_machine_that_has_not_changed_is_one(first: Estimate) -> None:
    known = first.carried_over(0.02 * SIGMA)
    values = [innovation(FAMILY, seen("S3", 100 + n), BAR, known).chi2_normalised for n in range(12)]
    assert np.mean(values) == pytest.approx(1.0, abs=0.15)


def test_expected_error_with_a_table_is_the_mean_over_drawn_machines(first: Estimate) -> None:
    """Compare with a plain evaluation of many drawn machines on the grid; the table was written for another machine."""
    grid = evaluation_grid(MODEL.ranges_mm, (8, 6, 5))
    unknowns, known = first.unknowns, first.carried_over()
    acting = ResidualWithTable.build(unknowns, known.scales, grid, TOOL)
    written = first.parameters + 0.3 * SIGMA
    rng = np.random.default_rng(8)
    basis = deviation_basis(MODEL, grid, TOOL)
    assert unknowns.modes is not None
    modes = unknowns.misfit_mm * unknowns.modes.at(grid, None)
    squares = []
    for z in rng.multivariate_normal(first.z, first.z_covariance, 400):
        field = basis @ (unknowns.parameters(z) - written) + modes @ z[unknowns.blocks.misfit]
        squares.append(
            [volumetric_error(grid + TOOL, field).raw_mm ** 2, volumetric_error(grid + TOOL, field).aligned_mm ** 2]
        )
    raw, aligned = np.sqrt(np.mean(squares, axis=0) + acting.unresolved_mm2)
    found = acting.of(first.z, first.z_covariance, written)
    assert found.raw_mm == pytest.approx(raw, rel=0.03)
    assert found.aligned_mm == pytest.approx(aligned, rel=0.03)
    own = acting.of(first.z, first.z_covariance, first.parameters)
    assert own.aligned_mm == pytest.approx(predicted_vce(first, grid, TOOL).aligned_mm, rel=0.01)
    left = uncompensated(unknowns, first.z, written)
    covariance = residual_covariance(unknowns, known.scales, left, first.z_covariance, grid, TOOL)
    assert np.trace(covariance) / len(grid) == pytest.approx(found.raw_mm**2, rel=1e-9)


def test_a_position_that_sees_a_jump_answers_whether_it_was() -> None:
    """Use two unknowns, one position that observes their sum and one that observes only the second, by hand."""
    questions = JumpQuestions(np.eye(2), np.eye(2))
    factors = np.array([[[3.0, 3.0]], [[0.0, 2.0]]])
    covariance = np.diag([0.5, 0.0])
    found = questions.noncentralities(factors, covariance)
    assert found == pytest.approx(np.array([[9.0 / 5.5, 9.0 / 5.5], [0.0, 4.0]]))
    pair = JumpQuestions.which_jump(np.eye(2)).noncentralities(factors, covariance)
    assert pair == pytest.approx(np.array([[0.0], [4.0]]))
