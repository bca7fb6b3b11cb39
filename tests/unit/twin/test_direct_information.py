"""Equations beside those of the ball centres, to which no scale applies, against dense matrices."""

from __future__ import annotations

import numpy as np
import pytest

from twin.identification.alternatives import alternatives
from twin.identification.evidence import in_principal_axes
from twin.identification.normal import DirectInformation, JointPrior, NormalEquations, Posterior, PriorPrecision
from twin.identification.scales import Scales
from twin.identification.unknowns import UnknownBlocks

BLOCKS = UnknownBlocks.of(4, 2, 0, (2, 1, 2, 2))
SIZE, ROWS, OTHERS = BLOCKS.size, 60, 7
RNG = np.random.default_rng(8)
DESIGN, DIRECT = RNG.normal(size=(ROWS, SIZE)), 2.0 * RNG.normal(size=(OTHERS, SIZE))
Y, TARGET = 3.0 * RNG.normal(size=ROWS), 3.0 * RNG.normal(size=OTHERS)
NORMAL = NormalEquations(DESIGN.T @ DESIGN, DESIGN.T @ Y, float(Y @ Y), ROWS)
AT = Scales(1.3, 0.8, 0.7, 1.4, 0.9, 1.1)


def dense(precision: PriorPrecision, scales: Scales) -> tuple[np.ndarray, np.ndarray]:
    """Return mean and covariance of the unknowns, with unit noise of the equations beside those of the balls."""
    matrix = DESIGN.T @ DESIGN / scales.noise**2 + DIRECT.T @ DIRECT + precision.matrix(scales)
    return np.linalg.solve(matrix, DESIGN.T @ Y / scales.noise**2 + DIRECT.T @ TARGET), np.linalg.inv(matrix)


@pytest.mark.parametrize("known", [None, JointPrior.at_zero(BLOCKS, np.diag([1.0, 2.0, 3.0, 4.0]) + 0.3)])
def test_mean_and_covariance(known: JointPrior | None) -> None:
    precision = PriorPrecision(BLOCKS, known, direct=DirectInformation(DIRECT, TARGET))
    mean, covariance = dense(precision, AT)
    posterior = Posterior.of(NORMAL.matrix, precision, AT)
    assert posterior.covariance == pytest.approx(covariance, abs=1e-12)
    found = posterior.solve(NORMAL.right / AT.noise**2 + precision.information_vector)
    assert found == pytest.approx(mean, abs=1e-12)


@pytest.mark.parametrize("known", [None, JointPrior.at_zero(BLOCKS, np.diag([1.0, 2.0, 3.0, 4.0]) + 0.3)])
def test_principal_axes_change_no_prediction(known: JointPrior | None) -> None:
    """The unknowns are turned: the length of their mean and the determinant of their covariance stay."""
    precision = PriorPrecision(BLOCKS, known, direct=DirectInformation(DIRECT, TARGET))
    mean, covariance = dense(precision, AT)
    normal, turned = in_principal_axes(NORMAL, precision)
    posterior = Posterior.of(normal.matrix, turned, AT)
    found = posterior.solve(normal.right / AT.noise**2 + turned.information_vector)
    assert np.linalg.norm(found) == pytest.approx(np.linalg.norm(mean), rel=1e-9)
    assert posterior.log_determinant == pytest.approx(-np.linalg.slogdet(covariance)[1], abs=1e-9)


def test_they_take_part_at_all_plausible_scales_but_do_not_choose_them() -> None:
    alone, both = PriorPrecision(BLOCKS), PriorPrecision(BLOCKS, direct=DirectInformation(DIRECT, TARGET))
    without, found = (
        alternatives(NORMAL, precision, Posterior.of(NORMAL.matrix, precision, AT), AT) for precision in (alone, both)
    )
    assert [one.scales for one in found] == [one.scales for one in without]
    for one in found:
        mean, covariance = dense(both, one.scales)
        assert one.z == pytest.approx(mean, abs=1e-12)
        assert one.covariance == pytest.approx(covariance, abs=1e-12)


def test_further_unknowns_do_not_occur_in_them() -> None:
    more = DirectInformation(DIRECT, TARGET).extended(2)
    assert (more.rows[:, :SIZE] == DIRECT).all()
    assert (more.rows[:, SIZE:] == 0.0).all()
    assert more.vector == pytest.approx(np.concatenate((DIRECT.T @ TARGET, [0.0, 0.0])))
