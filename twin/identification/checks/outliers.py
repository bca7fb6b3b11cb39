"""Outlying ball centres, found by studentised residuals. The three components of each residual are tested together.

Let r be the whitened residual (3,) of a ball (measured minus fitted centre), and C (3, 3) its covariance under the
model. The statistic t² = rᵀ C⁻¹ r compares the ball with a fit that leaves out this ball. All values of t² are divided
by a common scale, which follows from their median over the balls. Gross errors do not affect this median. The limit for
t² comes from the F distribution. The false alarm rate is shared by all balls (Bonferroni).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.special import fdtri

from twin.arrays import Array
from twin.errors import DataError
from twin.identification.centres import CentreEquations
from twin.identification.solution import Solution

_MEDIAN_OF_CHI2_3 = 2.365974
_MIN_NOISE = 0.3  # lower bound of the scale, relative to the stated noise
_COMPARABLE_SHARE = 0.05  # of the worst: a gross error distorts the fit, so smaller ones are tested after its removal
_RIDGE = 1e-6  # keeps the covariance invertible for a component that the fit absorbs entirely

Rows = np.ndarray[Any, np.dtype[np.int64]]


@dataclass(frozen=True, eq=False)
class WhitenedResiduals:
    """Residuals of a solution in the formulation `centres`, with their covariance under the model. Rows (measured ball
    centres) are sorted by position.

    `residuals` (n, 3) are whitened with `whitening` (n, 3, 3). `pose_basis` (n, 3, 6) is the part that the pose of the
    position takes up, and `unknowns_root` (n, 3, P) a root of the part that the other unknowns take up. `variance` is
    the square of the scale of the noise. `square` (n,) contains t² without the common scale, which is `scale`. `points`
    (n, 3) in mm are the measured tool points, and `counts` (K,) is the number of balls of each position.
    """

    residuals: Array
    whitening: Array
    pose_basis: Array
    unknowns_root: Array
    variance: float
    square: Array
    scale: float
    points: Array
    counts: Rows
    degrees_of_freedom: float

    def covariance_of(self, rows: slice) -> Array:
        """Return the covariance (3m, 3m) of the residuals of m rows of one position."""
        q = self.pose_basis[rows].reshape(-1, self.pose_basis.shape[2])
        root = self.unknowns_root[rows].reshape(len(q), -1)
        return np.asarray(self.variance * (np.eye(len(q)) * (1.0 + _RIDGE) - q @ q.T) - root @ root.T)


def contradicting_rows(found: WhitenedResiduals, false_alarm: float) -> Rows:
    """Return the indices of the rows (measured ball centres) to reject as outliers in one round of rejection. Rows are
    sorted by artefact position.

    In each position, only the row with the largest squared studentised residual t² is tested. It is rejected if its t²
    exceeds both of two limits: the limit that follows from the probability `false_alarm`, and 5 % of the largest t² of
    all rows.
    """
    square = found.square / found.scale
    # Without outliers, t²/3 follows the F distribution with 3 and f degrees of freedom. The division by the number of
    # rows (Bonferroni) makes `false_alarm` the probability for the whole set.
    limit = 3.0 * float(fdtri(3.0, found.degrees_of_freedom, 1.0 - false_alarm / len(square)))
    limit = max(limit, _COMPARABLE_SHARE * float(square.max()))
    starts = np.cumsum(found.counts) - found.counts
    largest = np.maximum.reduceat(square, starts)
    worst = starts + [int(part.argmax()) for part in np.split(square, starts[1:])]
    return np.asarray(worst[largest > limit])


def studentised_residuals(solution: Solution) -> WhitenedResiduals:
    """Return the residuals of a solution with the square t² of each studentised residual. Rows are sorted by artefact
    position.

    For the whitened residual r (3,) of a row with the covariance C (3, 3), t² is proportional to rᵀ C⁻¹ r. A common
    scale makes the median of all t² equal to the median of χ² with three degrees of freedom, unless the residuals are
    far smaller than the stated noise. Raise DataError if the solution is not in the formulation `centres`.
    """
    equations = solution.equations
    if not isinstance(equations, CentreEquations):
        raise DataError("studentised residuals require the formulation 'centres'")
    layout, size = equations.problem.layout, equations.problem.blocks.size
    variance = solution.scales.noise**2
    q = layout.unpad(equations.projector.q.reshape(layout.positions, -1, 3, 6))
    rows = equations.projected(size)
    spread_root = solution.posterior.whiten(rows.reshape(-1, size)).reshape(rows.shape)
    spread = spread_root @ spread_root.transpose(0, 2, 1)
    # covariance of the residual: noise minus the parts taken up by the pose and by the unknowns
    covariance = variance * (np.eye(3) * (1.0 + _RIDGE) - q @ q.transpose(0, 2, 1)) - spread
    residuals = layout.unpad(equations.remaining(solution.sides, solution.poses).reshape(layout.positions, -1, 3))
    solved = np.linalg.solve(covariance, residuals[:, :, None])[:, :, 0]
    square = np.einsum("ni,ni->n", residuals, solved)
    scale = max(float(np.median(square)) / _MEDIAN_OF_CHI2_3, (_MIN_NOISE / solution.scales.noise) ** 2)
    return WhitenedResiduals(
        residuals=residuals,
        whitening=equations.whitening,
        pose_basis=q,
        unknowns_root=spread_root,
        variance=variance,
        square=square,
        scale=scale,
        points=solution.sides[0],
        counts=layout.counts,
        degrees_of_freedom=solution.degrees_of_freedom,
    )
