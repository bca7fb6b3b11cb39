"""Outlying ball centres, found by studentised residuals. Each residual has three components, which are tested together.

Let r_i be the whitened residual of ball i, and C_i its covariance under the model. Then t² = r_iᵀ C_i⁻¹ r_i compares
the ball with a fit without it (leave one out). The scale of t² is the median over the balls, which gross errors do not
affect. The limit comes from the F distribution at a false alarm rate shared by all balls (Bonferroni).
"""

from __future__ import annotations

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


def contradicting_rows(solution: Solution, false_alarm: float) -> Rows:
    """Return the rows to reject in this round, as indices of rows sorted by position. The worst row of each position is
    rejected if it is beyond the limit."""
    square = studentised_squares(solution)
    limit = 3.0 * float(fdtri(3.0, solution.degrees_of_freedom, 1.0 - false_alarm / len(square)))
    limit = max(limit, _COMPARABLE_SHARE * float(square.max()))
    layout = solution.equations.problem.layout
    worst = layout.pad(square).argmax(axis=1) + np.concatenate(([0], np.cumsum(layout.counts)[:-1]))
    return np.asarray(worst[square[worst] > limit])


def studentised_squares(solution: Solution) -> Array:
    """Return t² (n,) of the rows, sorted by position, of a solution in the formulation `centres`. The values are scaled
    to the median of χ² with three degrees of freedom."""
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
    return np.asarray(square / scale)
