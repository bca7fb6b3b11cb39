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
from scipy.stats import norm

from twin.arrays import Array
from twin.artefact.artefact import Artefact
from twin.artefact.observations import Observations
from twin.identification.normal import PriorPrecision
from twin.identification.options import Options
from twin.identification.poses import pose_jacobian
from twin.identification.problem import build_problem
from twin.identification.scales import Scales
from twin.machine.machine_population import Family

POSE_SIGMA_MM = 1.0
"""Standard deviation in mm of each pose increment. It is far above the error of any touch, so that the pose is free in
effect, and low enough to keep the covariance well conditioned."""
NORMAL_MEDIAN = float(norm.ppf(0.75))
"""Median of the absolute value of a standard normal variable."""
LEAST_LEFT = 4
"""Number of balls that must remain when inconsistent balls are left out: one more than a pose needs."""


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
        return float(norm.isf(0.5 * self.false_alarm / (balls * len(self.directions))))

    def deviations(self, seen: Observations) -> tuple[Array, Array]:
        """Return two arrays (n, k) for n measured balls of one position: the deviation of each touch in mm from its
        prediction by all other touches, and the same divided by its standard deviation.

        With the covariance K of all touches and their deviations r from the artefact at its nominal shape, the
        deviation of touch i from its prediction is (K⁻¹r)ᵢ / (K⁻¹)ᵢᵢ, with the variance 1 / (K⁻¹)ᵢᵢ (Rasmussen and
        Williams 2006, section 5.4.2). If the touches of the whole position deviate more than the prior allows, the
        standardised deviations are divided by their robust standard deviation, because the machine is worse than
        its family then and not every touch is wrong.
        """
        residuals, covariance = self._touches(seen)
        factor = cho_factor(covariance, lower=True)
        weighted = cho_solve(factor, residuals)
        information = np.diagonal(cho_solve(factor, np.eye(len(residuals))))
        deviations, standardised = weighted / information, weighted / np.sqrt(information)
        spread = float(np.median(np.abs(standardised))) / NORMAL_MEDIAN
        shape = (seen.size, len(self.directions))
        return deviations.reshape(shape), (standardised / max(1.0, spread)).reshape(shape)

    def inconsistent(self, seen: Observations) -> tuple[InconsistentTouch, ...]:
        """Return the worst touch of each of the measured balls of one position that do not fit the others, the worst
        ball first.

        One ball after the other is left out, since a wrong touch also spoils the prediction of its neighbours. At
        least `LEAST_LEFT` balls remain; fewer balls cannot be checked.
        """
        left, found = np.arange(seen.size), list[InconsistentTouch]()
        while len(left) > LEAST_LEFT:
            deviations_mm, standardised = self.deviations(seen.select(left))
            place, touch = np.unravel_index(np.abs(standardised).argmax(), standardised.shape)
            ratio = abs(float(standardised[place, touch])) / self.limit(len(left))
            if ratio <= 1.0:
                break
            off_mm = float(deviations_mm[place, touch])
            found.append(InconsistentTouch(int(left[place]), int(touch), off_mm, abs(off_mm) / ratio))
            left = np.delete(left, place)
        return tuple(found)

    def _touches(self, seen: Observations) -> tuple[Array, Array]:
        """Return the deviations (n·k,) of the touches from the nominal shape at the best pose, in mm, and their
        covariance (n·k, n·k) with the pose free."""
        problem = build_problem(self.family, seen, self.artefact, self.options)
        layout = problem.layout
        left, local = problem.sides(np.zeros(problem.blocks.size))
        residuals = left - problem.poses.to_workpiece(layout, local)
        effects = layout.unpad(problem.design).reshape(3 * seen.size, -1)
        moves = layout.unpad(pose_jacobian(layout, problem.poses, problem.local, problem.arms))
        prior = np.linalg.inv(PriorPrecision(problem.blocks, problem.known).matrix(Scales()))
        pose = POSE_SIGMA_MM * moves.reshape(3 * seen.size, -1)
        centres = effects @ prior @ effects.T + pose @ pose.T + block_diag(*seen.covariance)
        # Touch along d: the deviation of the surface along d is d·r of the centre.
        touched = np.kron(np.eye(seen.size), self.directions)
        return touched @ residuals.reshape(-1), touched @ centres @ touched.T
