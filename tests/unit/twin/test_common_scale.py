"""Test of the common scale of the axes, compared with plain dense matrices and with its stated false alarm
probability."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from measured_set import bar, case_study, measured, truth_of
from numpy.typing import ArrayLike
from scipy.special import ndtr

from twin.identification import CommonScale, Options
from twin.identification.checks.common_scale import common_scale
from twin.identification.normal import Posterior
from twin.identification.problem import build_problem
from twin.identification.solution import Solution, solve

MODEL, FAMILY = case_study(2)
BAR = bar(5, sigma_mm=2e-3, cte_standard_uncertainty_per_k=2e-6)
THERMOMETER_K, HALL_C = 0.3, 23.0
OPTIONS = Options(
    outliers="none", estimate_scales=False, misfit_mm=0.0, temperature_standard_uncertainty_k=THERMOMETER_K
)


@pytest.fixture(scope="module")
def solution() -> Solution:
    truth = truth_of(MODEL, FAMILY.draw(np.random.default_rng(5), 1)[0])
    seen = measured("S1", 2, BAR, truth, np.random.default_rng(3), temperature_c=HALL_C)
    return solve(build_problem(FAMILY, seen, BAR, OPTIONS), OPTIONS, "centres")


def known_before() -> np.ndarray:
    """Covariance (3, 3) in (µm/m)² of the slopes of the axes minus the strain of the bar, from the files alone."""
    slopes = np.zeros(3)
    for axis, name in enumerate("XYZ"):
        low, high = MODEL.ranges_mm[axis]
        slopes[axis] = 2e6 / (high - low) * FAMILY.prior_standard_deviation[MODEL.index(f"E{name}{name}[1]")]
    thermometer = 1e6 * BAR.cte_per_k * THERMOMETER_K
    cte = 1e6 * BAR.cte_standard_uncertainty_per_k * (HALL_C - BAR.reference_temperature_c)
    arms = BAR.balls - BAR.balls.mean(axis=0)
    certificate = 1e6 * 2e-3 / np.linalg.norm(arms)
    return np.asarray(np.diag(slopes**2) + thermometer**2 + cte**2 + certificate**2)


def sharp(solution: Solution) -> Solution:
    """Return the solution of measurements that are far better than the files."""
    scales = replace(solution.scales, noise=1e-3)
    posterior = Posterior.of(solution.equations.matrix, solution.precision, scales)
    return replace(solution, scales=scales, posterior=posterior)


def test_the_expected_scale_follows_from_family_thermometer_expansion_and_certificate(solution: Solution) -> None:
    """The best linear estimate of a common scale has the variance 1 / 1'V⁻¹1."""
    expected = np.sqrt(1.0 / np.linalg.inv(known_before()).sum())
    assert common_scale(sharp(solution)).expected_um_per_m == pytest.approx(expected, rel=1e-2)


def test_the_probability_is_that_of_the_scale_in_units_of_what_was_expected(solution: Solution) -> None:
    found = common_scale(shifted(sharp(solution), (30e-6, 30e-6, 30e-6)))
    assert found.axes_um_per_m == pytest.approx((30.0, 30.0, 30.0), rel=0.05)
    assert found.scale_um_per_m == pytest.approx(30.0, rel=0.05)
    expected = 2.0 * float(ndtr(-found.scale_um_per_m / found.expected_um_per_m))
    assert np.log(found.false_alarm) == pytest.approx(np.log(expected), rel=0.05)


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_the_scale_of_one_axis_is_not_common(solution: Solution, axis: int) -> None:
    strain = np.zeros(3)
    strain[axis] = 60e-6
    assert common_scale(shifted(sharp(solution), strain)).false_alarm == 1.0


def shifted(solution: Solution, strain: ArrayLike) -> Solution:
    """Return the solution for a machine without other errors whose axes have the scales `strain` (3,)."""
    z, unknowns, strains = np.zeros_like(solution.z), solution.equations.problem.unknowns, np.asarray(strain)
    for axis, name in enumerate("XYZ"):
        low, high = MODEL.ranges_mm[axis]
        index = MODEL.index(f"E{name}{name}[1]")
        z[index] = 0.5 * strains[axis] * (high - low) / unknowns.scale[index]
    return drawn(solution, z, np.zeros_like(z))


def drawn(solution: Solution, z: np.ndarray, noise: np.ndarray) -> Solution:
    """Return the solution that a machine and an artefact with the unknowns z (P,) have, with noise (P,) of the right
    side of the normal equations in units of its standard deviation."""
    matrix, sigma = solution.equations.matrix, solution.scales.noise
    values, vectors = np.linalg.eigh(matrix)
    right = matrix @ z + sigma * vectors @ (np.sqrt(np.maximum(values, 0.0)) * noise)
    return replace(solution, z=solution.posterior.solve(right / sigma**2))


def test_a_scale_as_stated_is_called_impossible_no_more_often_than_stated(solution: Solution) -> None:
    rng, size = np.random.default_rng(1), len(solution.z)
    found = [
        common_scale(drawn(solution, rng.normal(size=size), rng.normal(size=size))).false_alarm for _ in range(1000)
    ]
    for limit in (0.01, 0.05, 0.2):
        assert np.mean(np.array(found) < limit) <= limit + 2.0 * np.sqrt(limit / len(found))


def test_the_named_errors_have_the_sign_of_a_reading_that_is_too_large() -> None:
    high = CommonScale(23.0, 1.0, 3.0, (22.0, 23.0, 24.0), 1e-6, 2.0, 34.5, 1500.0, 5.75e-6)
    assert high.causes == (
        "an artefact temperature too high by 2.00 K, an artefact length too long by 34.5 µm over 1500 mm or "
        "a CTE too large by 5.8e-06 1/K"
    )
    low = replace(high, temperature_k=None, length_um=-34.5, cte_per_k=-1e-5)
    assert low.causes == "an artefact length too short by 34.5 µm over 1500 mm or a CTE too small by 1e-05 1/K"
    assert replace(high, temperature_k=None, cte_per_k=None).causes == (
        "an artefact length too long by 34.5 µm over 1500 mm"
    )
