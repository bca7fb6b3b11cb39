"""Search for steps (sudden changes of level) in a series of nights.

Steps are found one by one. A candidate step is scored by the reduction of the residual sum of squares that it achieves,
in units of the noise variance. The residuals are those of the whole regression (level, slope, and the steps found so
far). The noise is estimated from the median of successive differences (median moving range), because neither the slope
nor single steps increase this median much. A candidate is accepted if the reduction exceeds a penalty of about
`PENALTY_PER_LOG` times ln n for n nights. The penalty accounts for the two fitted values of a step (size and time) and
for the search over times, as in the modified Bayesian information criterion (BIC) of Zhang & Siegmund, Biometrics 63
(2007).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike

from twin.arrays import Array
from twin.monitoring.drift import is_determined, regression_design

PENALTY_PER_LOG = 6.0
MIN_NIGHTS = 8
MAX_STEPS = 5
MIN_NOISE_SHARE = 1e-3
"""Lower bound of the noise as a share of the stated uncertainty; smaller residuals are rounding errors."""
MEDIAN_RANGE = 0.9539
"""Median of the range of two standard normal values: sqrt(2) times their upper quartile 0.6745."""

_DEPENDENT = 1e-10  # share of a column that is not explained by others, below which it depends on them


def find_steps(
    nights: ArrayLike, values: ArrayLike, sigmas: ArrayLike, known: Sequence[float] = ()
) -> tuple[float, ...]:
    """Return the times, in nights, of the steps (sudden changes of level) in `values`, in ascending order.

    The steps at the `known` times are included. A known step is omitted if it cannot be distinguished from the slope of
    the series or from another step. If there are fewer than `MIN_NIGHTS` values, only the known steps are returned. A
    new step needs two values on either side. It must also remain significant if any single value is omitted, which
    prevents an outlier from being reported as a step.
    """
    t, y, u = (np.asarray(given, dtype=np.float64) for given in (nights, values, sigmas))
    steps = list(_usable(t, known))
    if len(t) < MIN_NIGHTS:
        return tuple(steps)
    relative = u / np.median(u)
    # Divided by their relative uncertainties, all values have the same noise, whose size the differences give.
    scatter = max(_successive(y / relative), MIN_NOISE_SHARE * float(np.median(u)))
    while len(steps) < MAX_STEPS + len(known):
        best = _best(t, y, scatter * relative, steps)
        if best is None:
            break
        steps = sorted([*steps, best])
    return tuple(steps)


def _best(t: Array, y: Array, sigmas: Array, steps: Sequence[float]) -> float | None:
    """Return the time of the step that explains most, or None if there is no such step.

    The gain of the step must still exceed the penalty if any single value is omitted.
    """
    regression = _Regression.of(t, y, sigmas, steps)
    candidates = _candidates(t, steps)
    gains = regression.gains(candidates)
    penalty = _penalty(len(t))
    for index in np.argsort(-gains, kind="stable"):
        if gains[index] < penalty:
            return None
        at = candidates[int(index)]
        if (regression.gains_without_one_value(at) >= penalty).all():
            return float(t[at])
    return None


@dataclass(frozen=True, eq=False)
class _Regression:
    """Regression of n nights on p columns, each row divided by its standard uncertainty 1 / `weights`.

    `basis`, shape (n, p), has orthonormal columns that span the columns of the regression, and `residuals`, shape (n,),
    are orthogonal to them. A further column c, that of a step, reduces the residual sum of squares by
    (c' · r)² / |c'|², where c' is the part of c that is orthogonal to the basis and r are the residuals.
    """

    weights: Array
    basis: Array
    residuals: Array

    @classmethod
    def of(cls, t: Array, y: Array, sigmas: Array, steps: Sequence[float]) -> _Regression:
        weights = 1.0 / sigmas
        basis = np.linalg.qr(regression_design(t, steps) * weights[:, None])[0]
        return cls(weights, basis, y * weights - basis @ (basis.T @ (y * weights)))

    def gains(self, candidates: Sequence[int]) -> Array:
        """Return the reduction of the residual sum of squares by a step at each of the `candidates`, shape
        (n_candidates,). A candidate is the index of the first value after its step.
        """
        # The column of a step contains the weights of the values before it; cumulative sums serve all candidates.
        last_before = np.array(candidates, dtype=np.intp) - 1
        square = np.cumsum(self.weights**2)[last_before]
        shares = np.cumsum(self.weights[:, None] * self.basis, axis=0)[last_before]
        explained = np.cumsum(self.weights * self.residuals)[last_before]
        left = square - np.sum(shares**2, axis=1)
        gains: Array = np.divide(explained**2, left, out=np.zeros_like(left), where=left > _DEPENDENT * square)
        return gains

    def gains_without_one_value(self, at: int) -> Array:
        """Return the reduction of the residual sum of squares by the step before the value `at` if one value is
        omitted, for each of the n values, shape (n,).
        """
        column = np.where(np.arange(len(self.weights)) < at, self.weights, 0.0)
        column = column - self.basis @ (self.basis.T @ column)
        column /= np.linalg.norm(column)
        with_step = self.residuals - column * (column @ self.residuals)
        leverage = np.sum(self.basis**2, axis=1)
        before = _squares_without_one_value(self.residuals, leverage)
        return before - _squares_without_one_value(with_step, leverage + column**2)


def _squares_without_one_value(residuals: Array, leverage: Array) -> Array:
    """Return the residual sum of squares of a regression if one value is omitted, for each value (Belsley, Kuh and
    Welsch 1980). `leverage` is the diagonal of the projection on the columns. A value with leverage 1 has no residual;
    without it the sum remains.
    """
    freedom = 1.0 - leverage
    omitted: Array = np.divide(residuals**2, freedom, out=np.zeros_like(residuals), where=freedom > _DEPENDENT)
    return residuals @ residuals - omitted


def _penalty(count: int) -> float:
    """Return the penalty of a step; it is larger for few values, whose noise estimate is poor.

    It is chosen so that a step is found in about 1 of 50 series that contain none.
    """
    # count / (count - 5): 2.7 for 8 nights, 1.2 for 30
    return PENALTY_PER_LOG * float(np.log(count)) * count / (count - 5.0)


def _successive(y: Array) -> float:
    """Return the standard deviation of the noise in `y`. It is estimated from the median of successive differences
    after the slope has been removed."""
    differences = np.diff(y)
    return float(np.median(np.abs(differences - np.median(differences)))) / MEDIAN_RANGE


def _usable(t: Array, known: Sequence[float]) -> tuple[float, ...]:
    """Return the known steps, in ascending order, that leave the regression solvable."""
    kept: list[float] = []
    for at in sorted(set(known)):
        if len(t) > len(kept) + 3 and is_determined(t, [*kept, at]):
            kept.append(at)
    return tuple(kept)


def _candidates(t: Array, steps: Sequence[float]) -> list[int]:
    """Return the indices of the values before which a further step would leave at least two values on each level."""
    edges = [0, *(int(np.searchsorted(t, at)) for at in steps), len(t)]
    return [
        index
        for start, end in pairwise(edges)
        for index in range(start + 2, end - 1)
        # values of the same night cannot lie on different sides of a step
        if t[index] > t[index - 1]
    ]
