"""Uncertainty of the scales: the Fisher information against dense matrices, and the points that represent it."""

from __future__ import annotations

import numpy as np
import pytest

from twin.identification.alternatives import Alternative, alternatives, mean_and_covariance
from twin.identification.evidence import SCALE_PRIORS
from twin.identification.normal import Posterior, PriorPrecision
from twin.identification.scales import Scales
from twin.identification.unknowns import UnknownBlocks

BLOCKS = UnknownBlocks.of(5, 2, 0, (4, 3, 3, 3))
SCALES = Scales(1.3, 0.8, 0.7, 1.4, 0.9, 1.1)
ROWS = 70


def set_up(seed: int) -> tuple[np.ndarray, np.ndarray, tuple[Alternative, ...]]:
    rng = np.random.default_rng(seed)
    design = rng.normal(size=(ROWS, BLOCKS.size))
    y = design @ rng.normal(size=BLOCKS.size) + SCALES.noise * rng.normal(size=ROWS)
    matrix, precision = design.T @ design, PriorPrecision(BLOCKS)
    posterior = Posterior.of(matrix, precision, SCALES)
    z = posterior.solve(design.T @ y / SCALES.noise**2)
    return design, y, alternatives(matrix, precision, posterior, z, SCALES, ROWS)


def dense_log_covariance(design: np.ndarray) -> np.ndarray:
    """Return the covariance of the log scales from the measurement covariance and its derivatives by them."""
    parts = [SCALES.noise**2 * np.eye(ROWS)]
    for block, scale in zip((BLOCKS.parameters, *BLOCKS.kinds), SCALES.values[1:6], strict=True):
        parts.append(scale**2 * design[:, block] @ design[:, block].T)
    certificate = design[:, BLOCKS.certificate]
    inverse = np.linalg.inv(sum(parts) + certificate @ certificate.T)
    information = np.zeros((6, 6))
    for row, one in enumerate(parts):
        for column, other in enumerate(parts):
            information[row, column] = 0.5 * np.trace(inverse @ (2.0 * one) @ inverse @ (2.0 * other))
    for row, factor in enumerate((3.0, 30.0, 3.0, 3.0, 3.0, 3.0)):
        # noise and parameter prior about 1, each kind of misfit about the scale of the parameter prior
        of_row = np.eye(6)[row] - (np.eye(6)[1] if row > 1 else 0.0)
        information += np.outer(of_row, of_row) / np.log(factor) ** 2
    return np.linalg.inv(information)


def test_log_scales_have_the_covariance_of_the_dense_fisher_information() -> None:
    design, _, found = set_up(1)
    logs = np.log([one.scales.values for one in found])
    assert len(found) == 7
    assert logs.mean(axis=0) == pytest.approx(np.log(SCALES.values), abs=1e-9)
    assert np.cov(logs[:, :6].T, bias=True) == pytest.approx(dense_log_covariance(design), rel=1e-6, abs=1e-9)


def test_each_alternative_is_the_dense_posterior_under_its_scales() -> None:
    design, y, found = set_up(2)
    for one in found:
        deviations = np.ones(BLOCKS.size)
        for block, scale in zip((BLOCKS.parameters, *BLOCKS.kinds), one.scales.values[1:6], strict=True):
            deviations[block] = scale
        covariance = np.linalg.inv(design.T @ design / one.scales.noise**2 + np.diag(deviations**-2))
        assert one.covariance == pytest.approx(covariance, rel=1e-8, abs=1e-10)
        assert one.z == pytest.approx(covariance @ design.T @ y / one.scales.noise**2, rel=1e-8, abs=1e-9)


def test_together_they_are_wider_than_their_mean_by_how_they_differ() -> None:
    _, _, found = set_up(3)
    rng = np.random.default_rng(4)
    drawn = np.concatenate([rng.multivariate_normal(one.z, one.covariance, 6000) for one in found])
    mean, covariance = mean_and_covariance(found)
    assert mean == pytest.approx(drawn.mean(axis=0), abs=0.05)
    assert np.diagonal(covariance) == pytest.approx(drawn.var(axis=0), rel=0.06)


def test_scales_stay_within_their_bounds() -> None:
    design = np.random.default_rng(5).normal(size=(ROWS, BLOCKS.size)) * 1e-4  # weak: almost no information
    matrix, precision = design.T @ design, PriorPrecision(BLOCKS)
    scales = Scales(1.0, 2.9, 9.5, 0.11, 1.0, 1.0)
    posterior = Posterior.of(matrix, precision, scales)
    for one in alternatives(matrix, precision, posterior, np.zeros(BLOCKS.size), scales, ROWS):
        for value, prior in zip(one.scales.values, SCALE_PRIORS, strict=True):
            assert prior.low <= value * (1.0 + 1e-12)
            assert value <= prior.high * (1.0 + 1e-12)
