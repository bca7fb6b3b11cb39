"""Distribution of quadratic forms against scipy, sampling and brute-force evaluation of an estimate."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from measured_set import RANGES, TOOL, bar, case_study, measured
from scipy import stats

from twin.errors import DataError
from twin.identification import Estimate, Options, identify, predicted_vce
from twin.machine.forward_model import deviation_basis, exact_deviation
from twin.machine.volumetric import evaluation_grid
from twin.uncertainty.quadratic_distribution import QuadraticDistribution, covariance_factor
from twin.uncertainty.scale_mixture import mixture_components
from twin.uncertainty.volumetric_distribution import aligned_distributions, volumetric_distributions

PROBABILITIES = (1e-4, 0.025, 0.3, 0.5, 0.8, 0.975, 1.0 - 1e-4)


def plain(weights: list[float], shifts: list[float], least: float = 0.0) -> QuadraticDistribution:
    return QuadraticDistribution(np.array(weights), np.array(shifts), least)


@pytest.mark.parametrize("freedom", [1, 2, 3, 10, 90])
@pytest.mark.parametrize("noncentral", [0.0, 0.01, 1.0, 2.5, 30.0, 400.0])
def test_equal_weights_are_chi_square(freedom: int, noncentral: float) -> None:
    one = plain([3.0] * freedom, [np.sqrt(noncentral / freedom)] * freedom, 0.5)
    reference = stats.ncx2(freedom, noncentral) if noncentral else stats.chi2(freedom)
    for probability in PROBABILITIES:
        value = 0.5 + 3.0 * reference.ppf(probability)
        assert one.at_most(value) == pytest.approx(probability, abs=1e-10)
        assert one.exceeds(value) == pytest.approx(1.0 - probability, abs=1e-10)
        assert one.quantile(probability) == pytest.approx(value, rel=1e-6)
    assert one.mean == pytest.approx(0.5 + 3.0 * reference.mean())
    assert one.variance == pytest.approx(9.0 * reference.var())


@pytest.mark.parametrize("weight", [6.7e-8, 1e-12, 1.0])
def test_a_tail_that_is_smaller_than_any_number_is_zero(weight: float) -> None:
    one = QuadraticDistribution(np.array([weight]), np.array([0.0]), 0.0)
    assert one.exceeds(2e3 * weight) == 0.0
    assert one.exceeds(100.0 * max(weight, 20.0)) == 0.0
    assert one.exceeds(1e3 * weight) == pytest.approx(float(stats.chi2.sf(1e3, 1)), rel=1e-9)


def test_the_far_tail_is_no_rounding() -> None:
    assert plain([1.0] * 3, [0.0] * 3).exceeds(400.0) == pytest.approx(stats.chi2(3).sf(400.0), rel=1e-9, abs=0.0)
    assert plain([1.0] * 9, [0.0] * 9).at_most(1e-3) == pytest.approx(stats.chi2(9).cdf(1e-3), rel=1e-9, abs=0.0)


def imhof(weights: np.ndarray, shifts: np.ndarray, value: float) -> float:
    """Return P(Q > value) by Imhof's integral over real frequencies, summed step by step."""
    step = 0.1 / np.sqrt(2.0 * np.sum(weights**2 * (1.0 + 2.0 * shifts**2)))
    u = step * (np.arange(12_000) + 0.5)
    phase, size = -0.5 * value * u, np.zeros_like(u)
    for weight, shift in zip(weights, shifts, strict=True):
        x = weight * u
        phase += 0.5 * (np.arctan(x) + shift**2 * x / (1.0 + x**2))
        size += 0.25 * np.log1p(x**2) + 0.5 * shift**2 * x**2 / (1.0 + x**2)
    return float(0.5 + np.sum(np.sin(phase) * np.exp(-size) / u) * step / np.pi)


@pytest.mark.parametrize("shift", [0.0, 0.7, 3.0, 20.0])
@pytest.mark.parametrize("spread", [0.1, 1.0])
def test_against_the_integral_over_real_frequencies(shift: float, spread: float) -> None:
    """From nearly Gaussian to strongly skewed, on both sides of the mean and at it."""
    rng = np.random.default_rng(3)
    weights, shifts = np.exp(spread * rng.normal(size=12)), shift * rng.normal(size=12)
    one = QuadraticDistribution(weights, shifts, 0.0)
    for deviations in (-1.2, -0.3, -1e-9, 1e-9, 0.01, 0.5, 2.0, 4.0):
        value = one.mean + deviations * np.sqrt(one.variance)
        assert one.exceeds(value) == pytest.approx(imhof(weights, shifts, value), abs=1e-7)


def test_two_different_weights_against_the_convolution() -> None:
    """Compare with P(a x² + b y² ≤ q) as an integral over x."""
    a, b, q = 2.0, 0.3, 1.7
    x = np.linspace(0.0, np.sqrt(q / a), 200_001)
    inner = stats.norm.pdf(x) * (2.0 * stats.norm.cdf(np.sqrt(np.maximum(q - a * x**2, 0.0) / b)) - 1.0)
    assert plain([a, b], [0.0, 0.0]).at_most(q) == pytest.approx(2.0 * np.trapezoid(inner, x), abs=1e-8)


@pytest.mark.parametrize("spread", [1.0, 3.0, 8.0])
def test_many_weights_against_sampling(spread: float) -> None:
    rng = np.random.default_rng(4)
    weights, shifts = rng.exponential(size=60) ** spread, rng.normal(size=60)
    one = QuadraticDistribution(weights, shifts, 0.0)
    drawn = (rng.normal(size=(100_000, 60)) + shifts) ** 2 @ weights
    for probability in (0.01, 0.025, 0.25, 0.5, 0.75, 0.975, 0.99):
        doubt = np.sqrt(probability * (1.0 - probability) / len(drawn))
        assert np.mean(drawn <= one.quantile(probability)) == pytest.approx(probability, abs=4.0 * doubt)


def test_a_form_of_correlated_variables_against_sampling() -> None:
    """With a fixed field, a mean, correlation, and one direction without uncertainty."""
    rng = np.random.default_rng(9)
    columns, fixed = rng.normal(size=(30, 6)), rng.normal(size=30)
    factor = rng.normal(size=(6, 6))
    factor[2] = 0.0
    mean = rng.normal(size=6)
    one = QuadraticDistribution.of(
        columns.T @ columns / 30, columns.T @ fixed / 30, float(fixed @ fixed / 30), mean, factor @ factor.T
    )
    x = mean + rng.normal(size=(100_000, 6)) @ factor.T
    drawn = ((x @ columns.T + fixed) ** 2).mean(axis=1)
    assert one.mean == pytest.approx(drawn.mean(), rel=0.02)
    for probability in (0.025, 0.5, 0.975):
        doubt = np.sqrt(probability * (1.0 - probability) / len(drawn))
        assert np.mean(drawn <= one.quantile(probability)) == pytest.approx(probability, abs=4.0 * doubt)


@given(
    weights=st.lists(st.floats(1e-9, 1e3), min_size=1, max_size=12),
    shift=st.floats(0.0, 20.0),
    low=st.floats(0.001, 0.5),
    step=st.floats(0.001, 0.49),
)
def test_quantiles_rise_and_lead_back(weights: list[float], shift: float, low: float, step: float) -> None:
    one = plain(weights, [shift] * len(weights))
    first, second = one.quantile(low), one.quantile(low + step)
    assert 0.0 < first < second
    assert one.at_most(first) == pytest.approx(low, abs=1e-7)
    assert one.at_most(second) + one.exceeds(second) == pytest.approx(1.0, abs=1e-9)


def test_below_the_least_value_there_is_nothing() -> None:
    one = plain([1.0], [0.0], 2.0)
    assert one.at_most(1.9) == 0.0
    assert one.exceeds(1.9) == 1.0


@pytest.mark.parametrize("probability", [0.0, 1.0, -0.1, 1.5, float("nan")])
def test_a_probability_lies_between_zero_and_one(probability: float) -> None:
    with pytest.raises(DataError, match="between 0 and 1"):
        plain([1.0], [0.0]).quantile(probability)


IMPOSSIBLE = [
    (np.zeros((3, 3)), "zero"),
    (np.diag([1.0, -1e-6, 1.0]), "negative .*row 1"),
    (np.array([[1.0, 2.0], [2.0, 1.0]]), "positive semi-definite"),
    (np.array([[1.0, 0.5], [0.2, 1.0]]), "not symmetric"),
    (np.array([[1.0, np.nan], [np.nan, 1.0]]), "finite"),
    (np.ones((2, 3)), "square"),
]


@pytest.mark.parametrize(("covariance", "message"), IMPOSSIBLE)
def test_an_impossible_covariance_is_refused(covariance: np.ndarray, message: str) -> None:
    with pytest.raises(DataError, match=message):
        covariance_factor(covariance)


def test_a_singular_covariance_is_one_all_the_same() -> None:
    """Mixed mm and rad: one direction has no uncertainty, and variances differ by 10¹²."""
    covariance = np.diag([1.0, 0.0, 1e-12])
    covariance[0, 2] = covariance[2, 0] = 1e-6
    factor = covariance_factor(covariance)
    assert factor @ factor.T == pytest.approx(covariance, rel=1e-9, abs=1e-20)


def test_a_form_that_is_no_mean_square_is_refused() -> None:
    with pytest.raises(DataError, match="mean square"):
        QuadraticDistribution.of(np.diag([1.0, -1.0]), np.zeros(2), 0.0, np.zeros(2), np.eye(2))
    with pytest.raises(DataError, match="shape"):
        QuadraticDistribution.of(np.eye(3), np.zeros(2), 0.0, np.zeros(2), np.eye(2))


GRID = evaluation_grid(RANGES, (7, 5, 5))


def estimated(misfit_mm: float) -> Estimate:
    model, family = case_study(4)
    richer, wide = case_study(6)
    rng = np.random.default_rng(12)
    truth = wide.draw(rng, 1)[0]
    artefact = bar(7, 15.0, 0.8e-3)
    seen = measured("S3", 2, artefact, lambda at, tool: exact_deviation(richer, at, tool, truth), rng)
    return identify(model, seen, artefact, family, Options(outliers="none", misfit_mm=misfit_mm))


def drawn_fields(estimate: Estimate, rng: np.random.Generator, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Return random fields (count, 3n) of possible machines, and the same less the compensation model."""
    beside = 0.0 if estimate.misfit is None else np.sqrt(estimate.misfit.unresolved_mm2)
    basis = deviation_basis(estimate.model, GRID, TOOL).reshape(3 * len(GRID), -1)
    mean, covariance, columns = estimate.parameters, estimate.covariance, basis
    misfit = estimate.misfit
    if misfit is not None:
        columns = np.hstack((basis, misfit.amplitude_mm * misfit.modes.at(GRID).reshape(3 * len(GRID), -1)))
        mean = np.append(mean, misfit.coefficients)
        cross = misfit.cross_covariance
        covariance = np.block([[covariance, cross], [cross.T, misfit.covariance]])
    scale = np.sqrt(np.diagonal(covariance))
    root = scale[:, None] * np.linalg.cholesky(covariance / np.outer(scale, scale))
    drawn = mean + rng.normal(size=(count, len(mean))) @ root.T
    machines = drawn @ columns.T + beside * rng.normal(size=(count, len(columns)))
    return machines, machines - basis @ estimate.parameters


def aligned(fields: np.ndarray) -> np.ndarray:
    arms = (GRID - GRID.mean(axis=0)) / 1000.0
    motions = np.zeros((len(GRID), 3, 6))
    motions[:, :, :3] = np.eye(3)
    for k, axis in enumerate(np.eye(3)):
        motions[:, :, 3 + k] = np.cross(axis, arms)
    q = np.linalg.qr(motions.reshape(-1, 6))[0]
    return fields - (fields @ q) @ q.T


def with_one_scale(estimate: Estimate) -> Estimate:
    """Return the estimate without alternative scales and without unresolved misfit."""
    misfit = estimate.misfit and replace(estimate.misfit, unresolved_mm2=0.0)
    return replace(estimate, alternatives=(), misfit=misfit)


@pytest.mark.parametrize("misfit_mm", [0.0, 0.001])
def test_distributions_of_ve_and_vce_against_drawn_machines(misfit_mm: float) -> None:
    estimate = with_one_scale(estimated(misfit_mm))
    found = volumetric_distributions(estimate, GRID, TOOL)
    machines, left = drawn_fields(estimate, np.random.default_rng(3), 4000)
    for fields, distribution in ((machines, found.ve), (left, found.vce)):
        low, high = distribution.limits(0.95)
        for drawn, one in ((fields, "raw_mm"), (aligned(fields), "aligned_mm")):
            rms = np.sqrt((drawn**2).sum(axis=1) / len(GRID))
            assert np.mean(rms <= getattr(distribution.median, one)) == pytest.approx(0.5, abs=0.03)
            inside = (rms >= getattr(low, one)) & (rms <= getattr(high, one))
            assert np.mean(inside) == pytest.approx(0.95, abs=0.012)


def test_the_mean_square_is_that_of_the_prediction() -> None:
    estimate = estimated(0.001)
    expected = volumetric_distributions(estimate, GRID, TOOL).vce.expected
    predicted = predicted_vce(estimate, GRID, TOOL)
    assert expected.raw_mm == pytest.approx(predicted.raw_mm, rel=1e-6)
    assert expected.aligned_mm == pytest.approx(predicted.aligned_mm, rel=1e-6)


def test_the_aligned_ones_alone_are_the_same_and_the_unresolved_misfit_is_a_constant() -> None:
    estimate = estimated(0.001)
    both, alone = volumetric_distributions(estimate, GRID, TOOL), aligned_distributions(estimate, GRID, TOOL)
    for one, same, resolved in (
        (both.ve.aligned, alone.ve, alone.resolved_ve),
        (both.vce.aligned, alone.vce, alone.resolved_vce),
    ):
        assert (same.mean, same.variance) == pytest.approx((one.mean, one.variance), rel=1e-9)
        assert same.at_most(one.mean) == pytest.approx(one.at_most(one.mean), rel=1e-9)
        absent = [3.0 * part.unresolved_mm2 for part in mixture_components(estimate)]
        assert same.mean - resolved.mean == pytest.approx(np.mean(absent), rel=1e-6)
        assert resolved.mean < same.mean


def test_points_that_are_no_grid_do_as_well() -> None:
    estimate = estimated(0.001)
    low, high = np.array(RANGES).T
    scattered = np.random.default_rng(1).uniform(low, high, (60, 3))
    expected = volumetric_distributions(estimate, scattered, TOOL).vce.expected
    assert expected.aligned_mm == pytest.approx(predicted_vce(estimate, scattered, TOOL).aligned_mm, rel=1e-6)


def test_an_estimate_without_uncertainty_is_refused() -> None:
    estimate = with_one_scale(estimated(0.0))
    with pytest.raises(DataError, match="zero"):
        volumetric_distributions(replace(estimate, covariance=0.0 * estimate.covariance), GRID, TOOL)
    with pytest.raises(DataError, match="negative"):
        volumetric_distributions(replace(estimate, covariance=-estimate.covariance), GRID, TOOL)
