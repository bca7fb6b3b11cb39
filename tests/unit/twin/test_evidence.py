"""Marginal likelihood against a dense normal density, and its gradient against finite differences."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from twin.identification.evidence import in_principal_axes, most_likely_scales, negative_log_likelihood
from twin.identification.normal import JointPrior, NormalEquations, PriorPrecision
from twin.identification.scales import Scales
from twin.identification.unknowns import UnknownBlocks

BLOCKS = UnknownBlocks.of(4, 2, 0, (2, 1))


def equations(seed: int, rows: int = 60, truth: Scales | None = None) -> tuple[np.ndarray, np.ndarray, NormalEquations]:
    rng = np.random.default_rng(seed)
    truth = truth or Scales()
    design = rng.normal(size=(rows, 9))
    deviations = np.array([truth.prior] * 4 + [1.0] * 2 + [truth.mixed] * 2 + [truth.waves_x])
    y = design @ (rng.normal(size=9) * deviations) + truth.noise * rng.normal(size=rows)
    return design, y, NormalEquations(design.T @ design, design.T @ y, float(y @ y), rows)


def test_differences_of_the_likelihood_are_those_of_the_dense_density() -> None:
    design, y, normal = equations(1)

    def dense(scales: Scales) -> float:
        variances = np.array([scales.prior**2] * 4 + [1.0] * 2 + [scales.mixed**2] * 2 + [scales.waves_x**2])
        covariance = scales.noise**2 * np.eye(len(y)) + (design * variances) @ design.T
        return -2.0 * float(multivariate_normal.logpdf(y, np.zeros(len(y)), covariance))

    one, other = Scales(1.3, 0.7, 1.9, 0.6), Scales(0.8, 1.2, 0.4, 1.5)
    ours = [negative_log_likelihood(normal, PriorPrecision(BLOCKS), scales)[0] for scales in (one, other)]
    assert ours[0] - ours[1] == pytest.approx(dense(one) - dense(other), rel=1e-9)


def test_with_a_known_mean_and_covariance_too() -> None:
    """Joint prior of parameters and misfit, as carried over from an earlier estimate; the noise scale is free."""
    design, y, normal = equations(5)
    mixing = np.random.default_rng(6).normal(size=(7, 7))
    mean, covariance = np.linspace(-1.0, 1.0, 7), mixing @ mixing.T + np.eye(7)
    taken = np.array([True] * 4 + [False] * 2 + [True] * 3)
    inverse, information_vector = np.zeros((9, 9)), np.zeros(9)
    inverse[np.ix_(taken, taken)] = np.linalg.inv(covariance)
    information_vector[taken] = np.linalg.solve(covariance, mean)
    precision = PriorPrecision(BLOCKS, JointPrior(taken, inverse, information_vector))

    def dense(noise: float) -> float:
        spread = np.eye(9)
        spread[np.ix_(taken, taken)] = covariance
        total = noise**2 * np.eye(len(y)) + design @ spread @ design.T
        return -2.0 * float(multivariate_normal.logpdf(y, design[:, taken] @ mean, total))

    turned = in_principal_axes(normal, precision)
    ours = [negative_log_likelihood(*turned, Scales(noise, 2.0, 3.0))[0] for noise in (1.3, 0.8)]
    assert ours[0] - ours[1] == pytest.approx(dense(1.3) - dense(0.8), rel=1e-9)
    gradient = negative_log_likelihood(*turned, Scales(1.3))[1][0]
    up, down = (negative_log_likelihood(*turned, Scales(1.3 * np.exp(s)))[0] for s in (1e-5, -1e-5))
    assert gradient == pytest.approx((up - down) / 2e-5, rel=1e-5)
    found = most_likely_scales(normal, precision, Scales(1.0, 2.0, 3.0))
    assert (found.prior, found.mixed) == (2.0, 3.0)


@pytest.mark.parametrize("given", [None, np.diag([1.0, 2.0, 3.0, 4.0]) + 0.3])
def test_gradient_is_that_of_differences(given: np.ndarray | None) -> None:
    _, _, normal = equations(2)
    precision = PriorPrecision(BLOCKS, None if given is None else JointPrior.at_zero(BLOCKS, given))
    turned = in_principal_axes(normal, precision)
    at = np.log([1.3, 1.0 if given is not None else 0.7, 1.9, 0.6])
    gradient = negative_log_likelihood(*turned, Scales(*np.exp(at)))[1]
    for k in range(4) if given is None else (0, 2, 3):
        step = np.zeros(4)
        step[k] = 1e-5
        up, down = (negative_log_likelihood(*turned, Scales(*np.exp(at + sign * step)))[0] for sign in (1.0, -1.0))
        assert gradient[k] == pytest.approx((up - down) / 2e-5, rel=1e-5, abs=1e-5)


def test_scales_come_back_and_stay_within_bounds() -> None:
    _, _, normal = equations(3, rows=4000, truth=Scales(noise=2.5))
    found = most_likely_scales(normal, PriorPrecision(BLOCKS), Scales())
    assert found.noise == pytest.approx(2.5, rel=0.05)
    _, _, silent = equations(4, truth=Scales(1e-6, 1e-6, 1e-6))
    floor = most_likely_scales(silent, PriorPrecision(BLOCKS), Scales())
    assert floor.noise == pytest.approx(0.3, abs=0.05)
    assert 0.003 <= floor.mixed < 0.1
