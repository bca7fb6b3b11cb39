"""Equations beside those of the ball centres, to which the scale of the touch noise does not apply: dense matrices."""

from __future__ import annotations

import numpy as np
import pytest
from scale_prior import prior_of_logs
from scipy.stats import multivariate_normal

from twin.identification.alternatives import alternatives
from twin.identification.evidence import in_principal_axes, negative_log_likelihood
from twin.identification.normal import DirectInformation, JointPrior, NormalEquations, Posterior, PriorPrecision
from twin.identification.scales import Scales
from twin.identification.unknowns import UnknownBlocks

BLOCKS = UnknownBlocks.of(4, 2, 0, (2, 1, 2, 2))
SIZE, ROWS, OTHERS, FREE = BLOCKS.size, 60, 7, 6
RNG = np.random.default_rng(8)
DESIGN, DIRECT = RNG.normal(size=(ROWS, SIZE)), 2.0 * RNG.normal(size=(OTHERS, SIZE))
Y, TARGET = 3.0 * RNG.normal(size=ROWS), 3.0 * RNG.normal(size=OTHERS)
NORMAL = NormalEquations(DESIGN.T @ DESIGN, DESIGN.T @ Y, float(Y @ Y), ROWS)
PRECISION = PriorPrecision(BLOCKS, direct=DirectInformation(DIRECT, TARGET))
AT = Scales(1.3, 0.8, 0.7, 1.4, 0.9, 1.1)


def parts(scales: Scales) -> list[np.ndarray]:
    """Return the covariances of all readings by touch noise, parameters and four kinds of misfit, and of the rest."""
    both = np.vstack((DESIGN, DIRECT))
    noise = np.zeros(ROWS + OTHERS)
    noise[:ROWS] = scales.noise**2
    found = [np.diag(noise)]
    for block, scale in zip((BLOCKS.parameters, *BLOCKS.kinds), (scales.prior, *scales.kinds), strict=True):
        found.append(scale**2 * both[:, block] @ both[:, block].T)
    certificate = both[:, BLOCKS.certificate]
    return [*found, certificate @ certificate.T + np.diag(1.0 - np.sign(noise))]


def test_likelihood_and_gradient_are_those_of_the_dense_density() -> None:
    def dense(scales: Scales) -> float:
        both = np.concatenate((Y, TARGET))
        return -2.0 * float(multivariate_normal.logpdf(both, np.zeros(len(both)), sum(parts(scales))))

    other = Scales(0.8, 1.2, 0.4, 1.5, 0.7, 0.6)
    ours = [negative_log_likelihood(NORMAL, PRECISION, scales)[0] for scales in (AT, other)]
    assert ours[0] - ours[1] == pytest.approx(dense(AT) - dense(other), rel=1e-9)
    gradient = negative_log_likelihood(NORMAL, PRECISION, AT)[1]
    for number in range(FREE):
        step = np.zeros(12)
        step[number] = 1e-5
        up, down = (dense(Scales(*np.exp(np.log(AT.values) + sign * step))) for sign in (1.0, -1.0))
        assert gradient[number] == pytest.approx((up - down) / 2e-5, rel=1e-5)


def test_points_of_the_scales_lie_on_the_axes_of_the_dense_fisher_information() -> None:
    *by_scale, _ = parts(AT)
    inverse = np.linalg.inv(sum(parts(AT)))
    information = prior_of_logs()[:FREE, :FREE]
    for row, one in enumerate(by_scale):
        for column, other in enumerate(by_scale):
            information[row, column] += 2.0 * np.trace(inverse @ one @ inverse @ other)
    variances, axes = np.linalg.eigh(np.linalg.inv(information))
    found = alternatives(NORMAL, PRECISION, Posterior.of(NORMAL.matrix, PRECISION, AT), AT)
    away = (np.log([one.scales.values for one in found]) - np.log(AT.values))[:, :FREE] @ axes / np.sqrt(variances)
    for number in range(FREE):
        for one in away[2 * number : 2 * number + 2]:
            assert np.delete(one, number) == pytest.approx(0.0, abs=1e-6)


def test_mean_and_covariance_do_not_depend_on_the_axes() -> None:
    known = JointPrior.at_zero(BLOCKS, np.diag([1.0, 2.0, 3.0, 4.0]) + 0.3)
    precision = PriorPrecision(BLOCKS, known, direct=PRECISION.direct)
    posterior = Posterior.of(NORMAL.matrix, precision, AT)
    dense = DESIGN.T @ DESIGN / AT.noise**2 + DIRECT.T @ DIRECT + precision.matrix(AT)
    assert posterior.covariance == pytest.approx(np.linalg.inv(dense), abs=1e-12)
    mean = posterior.solve(NORMAL.right / AT.noise**2 + precision.information_vector)
    assert mean == pytest.approx(np.linalg.solve(dense, DESIGN.T @ Y / AT.noise**2 + DIRECT.T @ TARGET), abs=1e-12)
    before = negative_log_likelihood(NORMAL, precision, AT)[0]
    assert negative_log_likelihood(*in_principal_axes(NORMAL, precision), AT)[0] == pytest.approx(before, rel=1e-12)
