"""Consistency of the touches of one position of the artefact with each other.

The artefact is rigid, and the errors of the machine vary smoothly along it. Each touch can therefore be predicted from
all other touches of its position, without an estimate of the machine. A false trip, a particle on a ball or a ball that
has moved on its holder shows as a touch that deviates from its prediction. Balls that are touched too few times for a
form error of their own are checked in this way.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import block_diag, cho_factor, cho_solve
from scipy.special import ndtri

from twin.arrays import Array
from twin.artefact.artefact import Artefact
from twin.artefact.observations import Observations
from twin.artefact.position_set import CHECKABLE_BALLS
from twin.identification.options import Options
from twin.identification.poses import pose_jacobian
from twin.identification.problem import build_problem
from twin.machine.machine_population import Family

POSE_SIGMA_MM = 1.0
"""Standard deviation in mm of each pose increment. It is far above the error of any touch, so that the pose is free in
effect, and low enough to keep the covariance well conditioned."""
MACHINE_SCALES = (1.0, 2.0, 4.0, 8.0, 16.0, 32.0)
"""Factors by which the errors of the machine may exceed the prior of its family."""


@dataclass(frozen=True)
class InconsistentTouch:
    """Touch that does not fit the other touches of its position: the index `ball` of its ball among the measured balls,
    its index `touch` in the pattern, its deviation from its prediction in mm, and the limit of this deviation."""

    ball: int
    touch: int
    deviation_mm: float
    limit_mm: float


@dataclass(frozen=True, eq=False)
class TouchConsistency:
    """Check of the touches of one position.

    Every ball is touched along the k unit vectors `directions` (k, 3). `family`, `artefact` and `options` give the
    prior of the errors of machine and artefact. `false_alarm` is the probability that a position without any wrong
    touch is found to have one.
    """

    family: Family
    artefact: Artefact
    options: Options
    directions: Array
    false_alarm: float

    def limit(self, balls: int) -> float:
        """Return the limit of the standardised deviations of the touches on `balls` balls (Bonferroni)."""
        return -float(ndtri(0.5 * self.false_alarm / (balls * len(self.directions))))

    def deviations(self, seen: Observations) -> tuple[Array, Array]:
        """Return two arrays (n, k) for n measured balls of one position: the deviation of each touch in mm from its
        prediction by all other touches, and the same divided by its standard deviation.

        With the covariance K of all touches and their deviations r from the artefact at its nominal shape, the
        deviation of touch i from its prediction is (K⁻¹r)ᵢ / (K⁻¹)ᵢᵢ, with the variance 1 / (K⁻¹)ᵢᵢ (Rasmussen and
        Williams 2006, section 5.4.2).

        The errors of the machine have that multiple of their prior standard deviations in `MACHINE_SCALES` that makes
        the touches most likely, so that a machine that is worse than its family is not taken for wrong touches. The
        touches of the ball that deviates most are left out for this choice, because they may be wrong.
        """
        residuals, machine, beside = self._touches(seen)
        shape = (seen.size, len(self.directions))
        worst = np.abs(_deviations(residuals, machine + beside)[1]).reshape(shape).max(axis=1).argmax()
        kept = np.flatnonzero(np.repeat(np.arange(seen.size) != worst, len(self.directions)))
        without = np.ix_(kept, kept)
        scale = max(
            MACHINE_SCALES,
            key=lambda scale: _log_likelihood(residuals[kept], scale**2 * machine[without] + beside[without]),
        )
        deviations, standardised = _deviations(residuals, scale**2 * machine + beside)
        return deviations.reshape(shape), standardised.reshape(shape)

    def inconsistent(self, seen: Observations) -> tuple[InconsistentTouch, ...]:
        """Return the worst touch of each of the measured balls of one position that do not fit the others, the worst
        ball first.

        One ball after the other is left out, since a wrong touch also spoils the prediction of its neighbours. Fewer
        than `CHECKABLE_BALLS` balls cannot be checked.
        """
        left, found = np.arange(seen.size), list[InconsistentTouch]()
        while len(left) >= CHECKABLE_BALLS:
            deviations_mm, standardised = self.deviations(seen.select(left))
            place, touch = np.unravel_index(np.abs(standardised).argmax(), standardised.shape)
            ratio = abs(float(standardised[place, touch])) / self.limit(len(left))
            if ratio <= 1.0:
                break
            off_mm = float(deviations_mm[place, touch])
            found.append(InconsistentTouch(int(left[place]), int(touch), off_mm, abs(off_mm) / ratio))
            left = np.delete(left, place)
        return tuple(found)

    def _touches(self, seen: Observations) -> tuple[Array, Array, Array]:
        """Return the deviations (n·k,) of the touches from the nominal shape at the best pose, in mm, and two parts of
        their covariance (n·k, n·k): that of the errors of the machine, and that of noise, artefact and free pose."""
        problem = build_problem(self.family, seen, self.artefact, self.options)
        layout, blocks = problem.layout, problem.blocks
        left, local = problem.sides(np.zeros(blocks.size))
        residuals = left - problem.poses.to_workpiece(layout, local)
        # Touch along d: the deviation of the surface along d is d·r of the centre.
        touched = np.kron(np.eye(seen.size), self.directions)
        effects = touched @ layout.unpad(problem.design).reshape(3 * seen.size, -1)
        moves = layout.unpad(pose_jacobian(layout, problem.poses, problem.local, problem.arms))
        pose = POSE_SIGMA_MM * touched @ moves.reshape(3 * seen.size, -1)
        of_machine = np.zeros(blocks.size, dtype=bool)
        of_machine[blocks.parameters] = of_machine[blocks.misfit] = True
        machine, artefact = effects[:, of_machine], effects[:, ~of_machine]
        noise = touched @ block_diag(*seen.covariance) @ touched.T
        return touched @ residuals.reshape(-1), machine @ machine.T, artefact @ artefact.T + pose @ pose.T + noise


def _deviations(residuals: Array, covariance: Array) -> tuple[Array, Array]:
    """Return the deviations (m,) of `residuals` (m,) from their predictions by all others, and the same in units of
    their standard deviations."""
    factor = cho_factor(covariance, lower=True)
    weighted = cho_solve(factor, residuals)
    information = np.diagonal(cho_solve(factor, np.eye(len(residuals))))
    return weighted / information, weighted / np.sqrt(information)


def _log_likelihood(residuals: Array, covariance: Array) -> float:
    """Return the logarithm of the normal density of `residuals` (m,) with `covariance` (m, m), without its constant."""
    factor, lower = cho_factor(covariance, lower=True)
    square = float(residuals @ cho_solve((factor, lower), residuals))
    return -0.5 * square - float(np.log(np.diagonal(factor)).sum())
