"""Ball centres that contradict the rest: studentised residuals of three components at a time.

For ball i with remaining whitened residual r_i and its covariance C_i under the model, t² = r_iᵀ C_i⁻¹ r_i is what the
ball would say against a fit without it (leave one out). Its scale is taken from the median over the balls, which gross
errors do not move, and the limit from the F distribution at a false alarm rate shared by all balls (Bonferroni).
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
_QUIETEST = 0.3  # of the stated noise: closer agreement than this is not taken as the scale
_COMPARABLE = 0.05  # of the worst: one gross error bends the fit, so lesser ones are judged once it is gone
_RIDGE = 1e-6  # a component that the fit takes up entirely says nothing

Rows = np.ndarray[Any, np.dtype[np.int64]]


def contradicting_rows(solution: Solution, false_alarm: float) -> Rows:
    """Sorted rows to be rejected now: of each position at most the worst one beyond the limit."""
    square = studentised_squares(solution)
    limit = 3.0 * float(fdtri(3.0, solution.degrees_of_freedom, 1.0 - false_alarm / len(square)))
    limit = max(limit, _COMPARABLE * float(square.max()))
    layout = solution.equations.problem.layout
    worst = layout.pad(square).argmax(axis=1) + np.concatenate(([0], np.cumsum(layout.counts)[:-1]))
    return np.asarray(worst[square[worst] > limit])


def studentised_squares(solution: Solution) -> Array:
    """t² (n,) of the sorted rows of a solution in `centres`, scaled so that its median is that of χ² with three degrees
    of freedom."""
    equations = solution.equations
    if not isinstance(equations, CentreEquations):
        raise DataError("studentised residuals belong to the formulation of ball centres")
    layout, size = equations.problem.layout, equations.problem.blocks.size
    variance = solution.scales.noise**2
    q = layout.unpad(equations.projector.q.reshape(layout.positions, -1, 3, 6))
    rows = equations.projected(size)
    spread_root = solution.posterior.whiten(rows.reshape(-1, size)).reshape(rows.shape)
    spread = spread_root @ spread_root.transpose(0, 2, 1)
    covariance = variance * (np.eye(3) * (1.0 + _RIDGE) - q @ q.transpose(0, 2, 1)) - spread
    residuals = layout.unpad(equations.remaining(solution.sides, solution.poses).reshape(layout.positions, -1, 3))
    solved = np.linalg.solve(covariance, residuals[:, :, None])[:, :, 0]
    square = np.einsum("ni,ni->n", residuals, solved)
    scale = max(float(np.median(square)) / _MEDIAN_OF_CHI2_3, (_QUIETEST / solution.scales.noise) ** 2)
    return np.asarray(square / scale)
