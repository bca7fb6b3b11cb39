"""Test of the artefact's certificate: comparison of the estimated errors of the certified ball centres with the stated
uncertainty of the certificate.

The errors of the certified centres are e = L u. The covariance of the certificate is L Lᵀ, and the unknowns u have a
unit normal prior. Let C be the posterior covariance of u. If the certificate is right, the posterior mean m of u has
the covariance I - C. If the centre of one ball is wrong by g (3,) in mm, the mean of u becomes W g, where W contains
the three columns of the pseudoinverse of L that belong to the ball. With the score s = Wᵀ m and its covariance
M = Wᵀ (I - C) W, the generalised likelihood ratio test of g = 0 is

    t² = sᵀ M⁻¹ s,    estimate of g = M⁻¹ s

(Baarda's data snooping, with three components per ball). Under a right certificate, t² has a χ² distribution with three
degrees of freedom. Its root t is the contradiction in standard deviations along the worst direction.

One wrong ball also raises t of its neighbours, since the estimate spreads the error over all balls. Balls are therefore
freed one after the other, the worst first, and the other balls are tested with the freed ones left free.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from twin.arrays import Array
from twin.identification.normal import JointPrior
from twin.identification.unknowns import Unknowns

CONTRADICTION_SIGMA = 5.0
"""Contradiction in standard deviations from which the certificate of a ball counts as wrong. For 11 balls with a right
certificate and an exact model, the probability that one of them exceeds it is 2e-4."""

_UNSEEN = 1e-2  # share of the certificate's variance: a direction that the measurement improves by less is not tested
_OPEN = 1e-6  # share of the precision that a freed centre keeps, so that an unmeasured direction stays determined


@dataclass(frozen=True)
class BallCheck:
    """Comparison of one certified ball centre with the measurements.

    `contradiction` is in standard deviations along the worst direction. `apparent_error_mm` is the error of the
    certified centre in the artefact's frame that explains the measurements best; it is 0 along directions that the
    measurements do not see. `certified` is False if the artefact file declares the centre as not certified.
    """

    ball: int
    contradiction: float
    apparent_error_mm: tuple[float, float, float]
    certified: bool = True

    @property
    def direction(self) -> str:
        """Axis of the artefact's frame (X, Y or Z) along which the apparent error is largest."""
        return "XYZ"[int(np.argmax(np.abs(self.apparent_error_mm)))]


def check_certificate(
    unknowns: Unknowns, z: Array, z_covariance: Array, free: Sequence[int] = ()
) -> tuple[BallCheck, ...]:
    """Return the check of each ball, in the order of the balls. The result is empty if the certificate states no
    uncertainty.

    `z` (P,) and `z_covariance` (P, P) are the posterior of the unknowns for the prior of `prior_with_free_balls` with
    the balls `free`.
    """
    score = _Score.of(unknowns, z, z_covariance, free)
    if score is None:
        return ()
    uncertified = unknowns.artefact.uncertified
    while (wrong := score.worst_ball((*uncertified, *free))) is not None and len(free) < max_free_balls(unknowns):
        free = (*free, wrong)
    balls = range(len(unknowns.artefact.balls))
    return tuple(BallCheck(ball, *score.tested(ball, free), ball not in uncertified) for ball in balls)


def worst_ball(unknowns: Unknowns, z: Array, z_covariance: Array, free: Sequence[int]) -> int | None:
    """Return the certified ball that contradicts its certificate most, apart from the balls in `free`, or None if none
    exceeds `CONTRADICTION_SIGMA`. The arguments are those of `check_certificate`."""
    score = _Score.of(unknowns, z, z_covariance, free)
    return None if score is None else score.worst_ball((*unknowns.artefact.uncertified, *free))


def agreeing_balls(unknowns: Unknowns, z: Array, z_covariance: Array, free: Sequence[int]) -> tuple[int, ...]:
    """Return the balls of `free` that agree with their certificate. The arguments are those of
    `check_certificate`."""
    score = _Score.of(unknowns, z, z_covariance, free)
    return () if score is None else tuple(ball for ball in free if score.tested(ball, free)[0] <= CONTRADICTION_SIGMA)


def max_free_balls(unknowns: Unknowns) -> int:
    """Return the largest number of balls that may be freed: the others must define the artefact."""
    return (len(unknowns.artefact.balls) - len(unknowns.artefact.uncertified)) // 3


def prior_with_free_balls(unknowns: Unknowns, known: JointPrior | None, balls: Sequence[int]) -> JointPrior:
    """Return the prior of the unknowns in which the centres of `balls` are not certified. `known` is the joint prior of
    unknowns other than the errors of the certificate, or None."""
    blocks = unknowns.blocks
    if known is None:
        known = JointPrior(np.zeros(blocks.size, dtype=bool), np.zeros((blocks.size,) * 2), np.zeros(blocks.size))
    members, precision = known.members.copy(), known.precision.copy()
    members[blocks.certificate] = True
    shift = _shift(unknowns, balls)
    # a free shift V g of the prior mean with orthonormal V leaves the precision 1 - V Vᵀ of the unit prior
    precision[blocks.certificate, blocks.certificate] = np.eye(len(shift)) - (1.0 - _OPEN) * shift @ shift.T
    return JointPrior(members, precision, known.information_vector)


def _shift(unknowns: Unknowns, balls: Sequence[int]) -> Array:
    """Return orthonormal columns (m, k) for the errors of the certified centres of `balls`."""
    columns = _inverse_factor(unknowns.artefact.certificate)[:, _columns(balls)]
    basis, values, _ = np.linalg.svd(columns, full_matrices=False)
    return np.asarray(basis[:, values > _OPEN * values.max(initial=0.0)])


@dataclass(frozen=True, eq=False)
class _Score:
    """Score s (3N,) and its covariance M (3N, 3N) for errors of the N certified centres.

    The errors of a ball are in units of `unit_mm` (3N,), the standard uncertainty of its centre per direction. The
    eigenvalues of M are therefore the shares, from 0 to 1, by which the measurements improve the certificate.
    """

    score: Array
    covariance: Array
    unit_mm: Array

    @classmethod
    def of(cls, unknowns: Unknowns, z: Array, z_covariance: Array, free: Sequence[int]) -> _Score | None:
        """Return the score, or None if the certificate states no uncertainty. The arguments are those of
        `check_certificate`."""
        block, factor = unknowns.blocks.certificate, unknowns.artefact.certificate
        if factor.shape[1] == 0:
            return None
        mean, covariance = z[block], z_covariance[block, block]
        if free:
            # the unit prior restored: information V Vᵀ added to the posterior with the free shift V g
            shift = _shift(unknowns, free)
            across = covariance @ shift
            gain = across @ np.linalg.inv(np.eye(shift.shape[1]) / (1.0 - _OPEN) + shift.T @ across)
            mean, covariance = mean - gain @ (shift.T @ mean), covariance - gain @ across.T
        inverse = _inverse_factor(factor)
        weight = np.square(inverse).sum(axis=0).reshape(-1, 3).mean(axis=1)
        unit_mm = np.repeat(np.where(weight > 0.0, weight, 1.0) ** -0.5, 3)
        inverse = inverse * unit_mm
        return cls(inverse.T @ mean, inverse.T @ (np.eye(len(mean)) - covariance) @ inverse, unit_mm)

    def worst_ball(self, free: Sequence[int]) -> int | None:
        """Return the ball with the largest contradiction, apart from the balls in `free`, or None if none exceeds
        `CONTRADICTION_SIGMA`."""
        found = {ball: self.tested(ball, free)[0] for ball in range(len(self.score) // 3) if ball not in free}
        worst = max(found, key=lambda ball: found[ball], default=None)
        return worst if worst is not None and found[worst] > CONTRADICTION_SIGMA else None

    def tested(self, ball: int, free: Sequence[int]) -> tuple[float, tuple[float, float, float]]:
        """Return the contradiction t of a ball and its apparent error in mm. All other balls in `free` are left
        free."""
        own, others = _columns([ball]), _columns([one for one in free if one != ball])
        score, covariance = self.score[own], self.covariance[np.ix_(own, own)]
        if others.size:
            across = self.covariance[np.ix_(own, others)]
            gain = across @ _seen_inverse(self.covariance[np.ix_(others, others)])
            score, covariance = score - gain @ self.score[others], covariance - gain @ across.T
        estimate = _seen_inverse(covariance) @ score
        x, y, z = (self.unit_mm[own] * estimate).tolist()
        return math.sqrt(max(float(score @ estimate), 0.0)), (x, y, z)


def _seen_inverse(covariance: Array) -> Array:
    """Return the inverse of a covariance (m, m) within the directions that the measurements see."""
    values, vectors = np.linalg.eigh(covariance)
    seen = values > _UNSEEN
    return np.asarray((vectors[:, seen] / values[seen]) @ vectors[:, seen].T)


def _inverse_factor(factor: Array) -> Array:
    """Return the pseudoinverse (m, 3N) of the factor L (3N, m) of the certificate's covariance."""
    if np.count_nonzero(factor) == factor.shape[1]:  # a single entry per column
        return np.asarray(np.divide(1.0, factor, out=np.zeros_like(factor), where=factor != 0.0).T)
    return np.asarray(np.linalg.pinv(factor))


def _columns(balls: Sequence[int]) -> np.ndarray[Any, np.dtype[np.int64]]:
    """Return the indices of the coordinates of `balls` among the 3N coordinates."""
    return np.asarray((3 * np.array(balls, dtype=np.int64)[:, None] + np.arange(3)).reshape(-1))
