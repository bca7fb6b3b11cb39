"""Uncertainty of the scales: the Fisher information against dense matrices, and the points that represent it."""

from __future__ import annotations

import numpy as np
import pytest
from scale_prior import prior_of_logs
from scipy.stats import multivariate_normal

from twin.identification.alternatives import Alternative, alternatives, mean_and_covariance
from twin.identification.evidence import SCALE_PRIORS, most_likely_scales
from twin.identification.normal import NormalEquations, Posterior, PriorPrecision
from twin.identification.scales import Scales
from twin.identification.unknowns import UnknownBlocks

BLOCKS = UnknownBlocks.of(5, 2, 0, (4, 3, 3, 3))
SCALES = Scales(1.3, 0.8, 0.7, 1.4, 0.9, 1.1)
ROWS = 70
FREE = 6


def found_from(design: np.ndarray, y: np.ndarray, scales: Scales = SCALES) -> tuple[Alternative, ...]:
    normal = NormalEquations(design.T @ design, design.T @ y, float(y @ y), len(y))
    precision = PriorPrecision(BLOCKS)
    return alternatives(normal, precision, Posterior.of(normal.matrix, precision, scales), scales)


def set_up(seed: int) -> tuple[np.ndarray, np.ndarray, tuple[Alternative, ...]]:
    rng = np.random.default_rng(seed)
    design = rng.normal(size=(ROWS, BLOCKS.size))
    y = design @ rng.normal(size=BLOCKS.size) + SCALES.noise * rng.normal(size=ROWS)
    return design, y, found_from(design, y)


def dense_parts(design: np.ndarray, scales: np.ndarray) -> tuple[np.ndarray, ...]:
    """Return the covariances of the measurements by noise, parameters and four kinds of misfit, and of the rest."""
    parts = [scales[0] ** 2 * np.eye(len(design))]
    for block, scale in zip((BLOCKS.parameters, *BLOCKS.kinds), scales[1:], strict=True):
        parts.append(scale**2 * design[:, block] @ design[:, block].T)
    certificate = design[:, BLOCKS.certificate]
    return (*parts, certificate @ certificate.T)


def dense_log_covariance(design: np.ndarray) -> np.ndarray:
    """Return the covariance of the log scales from the measurement covariance and its derivatives by them."""
    *parts, rest = dense_parts(design, np.array(SCALES.values[:FREE]))
    inverse = np.linalg.inv(sum(parts) + rest)
    information = prior_of_logs()[:FREE, :FREE]
    for row, one in enumerate(parts):
        for column, other in enumerate(parts):
            information[row, column] += 0.5 * np.trace(inverse @ (2.0 * one) @ inverse @ (2.0 * other))
    return np.asarray(np.linalg.inv(information))


def test_points_lie_on_the_principal_axes_of_the_dense_fisher_information() -> None:
    design, _, found = set_up(1)
    logs = (np.log([one.scales.values for one in found]) - np.log(SCALES.values))[:, :FREE]
    assert len(found) == 2 * FREE
    variances, axes = np.linalg.eigh(dense_log_covariance(design))
    away = (logs @ axes) / np.sqrt(FREE * variances)
    for number in range(FREE):
        one, other = away[2 * number : 2 * number + 2]
        assert np.delete(one, number) == pytest.approx(0.0, abs=1e-6)
        assert np.delete(other, number) == pytest.approx(0.0, abs=1e-6)
        assert one[number] * other[number] < 0.0
        assert 0.2 <= abs(one[number]) <= 2.0


def test_a_point_lies_where_the_dense_density_falls_as_that_of_a_normal_distribution() -> None:
    """One step along an axis, from the dense density: exactly for a parabola, nearly for what is nearly one."""
    design, y, found = set_up(6)
    prior = prior_of_logs()

    def dense(logs: np.ndarray) -> float:
        covariance = sum(dense_parts(design, np.exp(logs[:FREE])))
        return float(multivariate_normal.logpdf(y, np.zeros(ROWS), covariance)) - 0.5 * float(logs @ prior @ logs)

    centre = np.log(SCALES.values)
    variances, axes = np.linalg.eigh(dense_log_covariance(design))
    for one in found:
        moved = np.log(one.scales.values) - centre
        number = int(np.abs(moved[:FREE] @ axes / np.sqrt(variances)).argmax())
        full = np.zeros(12)
        full[:FREE] = np.sign(moved[:FREE] @ axes[:, number]) * np.sqrt(FREE * variances[number]) * axes[:, number]
        rise = 2.0 * (dense(centre) - dense(centre + full))
        factor = np.clip(np.sqrt(FREE / rise), 0.2, 2.0) if rise > 0.0 else 2.0
        taken = float(np.linalg.norm(moved) / np.linalg.norm(full))
        assert taken == pytest.approx(factor, rel=1e-6)


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


def test_a_scale_of_errors_that_are_not_seen_is_not_taken_for_far_larger() -> None:
    """Many waves of which the machine has none, each hardly seen: large scales are refuted, small ones are not."""
    rng, blocks = np.random.default_rng(8), UnknownBlocks.of(5, 2, 0, (4, 20, 3, 3))
    design = 0.2 * rng.normal(size=(ROWS, blocks.size))
    true = rng.normal(size=blocks.size)
    true[blocks.kinds[1]] = 0.0
    y = design @ true + rng.normal(size=ROWS)
    normal = NormalEquations(design.T @ design, design.T @ y, float(y @ y), ROWS)
    precision = PriorPrecision(blocks)
    scales = most_likely_scales(normal, precision, Scales())
    found = alternatives(normal, precision, Posterior.of(normal.matrix, precision, scales), scales)
    logs = np.log([one.scales.waves_x for one in found]) - np.log(scales.waves_x)
    assert -logs.min() > 1.3 * logs.max()


def test_scales_stay_within_their_bounds() -> None:
    design = np.random.default_rng(5).normal(size=(ROWS, BLOCKS.size)) * 1e-4  # weak: almost no information
    for one in found_from(design, np.zeros(ROWS), Scales(1.0, 2.9, 9.5, 0.11, 1.0, 1.0)):
        for value, prior in zip(one.scales.values, SCALE_PRIORS, strict=True):
            assert prior.low <= value * (1.0 + 1e-12)
            assert value <= prior.high * (1.0 + 1e-12)
