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

import numpy as np
from numpy.typing import ArrayLike, NDArray

from twin.arrays import Array
from twin.monitoring.drift import SAME_NIGHT
from twin.monitoring.level_regression import LevelRegression

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
    regression = LevelRegression.of(t, y, sigmas, steps)
    candidates = _candidates(t, steps)
    found = gains(regression, candidates)
    penalty = _penalty(len(t))
    enough = np.flatnonzero(found >= penalty)
    for at in candidates[enough[np.argsort(-found[enough], kind="stable")]]:
        if (gains_without_one_value(regression, int(at)) >= penalty).all():
            return float(t[at])
    return None


def gains(regression: LevelRegression, candidates: NDArray[np.intp]) -> Array:
    """Return the reduction of the residual sum of squares by a step at each of the `candidates`, shape (n_candidates,).
    A candidate is the index of the first value after its step.

    A further column c reduces the sum by (c' · r)² / |c'|², where c' is the part of c that is orthogonal to the
    regression and r are the residuals.
    """
    square, orthogonal, explained = regression.step_columns(candidates)
    found: Array = np.divide(
        explained**2, orthogonal, out=np.zeros_like(orthogonal), where=orthogonal > _DEPENDENT * square
    )
    return found


def gains_without_one_value(regression: LevelRegression, at: int) -> Array:
    """Return the reduction of the residual sum of squares by the step before the value `at` if one value is omitted,
    for each of the n values, shape (n,).
    """
    column = regression.step_column(at)
    with_step = regression.residuals - column * (column @ regression.residuals)
    leverages = regression.leverages
    before = _squares_without_one_value(regression.residuals, leverages)
    return before - _squares_without_one_value(with_step, leverages + column**2)


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
    """Return the known steps, in ascending order, that leave the regression solvable (`is_determined`)."""
    # parted[j] is the number of values before j that are of another night than the value before them
    parted = np.concatenate(([0, 0], np.cumsum(np.diff(t) > SAME_NIGHT)))
    kept: list[float] = []
    start, spread = 0, False  # first value of the last level; True if an earlier level has values of different nights
    for at in sorted(set(known)):
        end = int(np.searchsorted(t, at))
        closed = spread or bool(parted[end] > parted[min(start + 1, end)])
        opened = bool(parted[-1] > parted[min(end + 1, len(t))])
        if len(t) > len(kept) + 3 and start < end < len(t) and (closed or opened):
            kept.append(at)
            start, spread = end, closed
    return tuple(kept)


def _candidates(t: Array, steps: Sequence[float]) -> NDArray[np.intp]:
    """Return the indices of the values before which a further step would leave at least two values on each level."""
    # values of the same night cannot lie on different sides of a step
    possible = np.concatenate(([False], np.diff(t) > 0.0))
    for edge in (0, *np.searchsorted(t, steps).tolist(), len(t)):
        possible[max(edge - 1, 0) : edge + 2] = False
    return np.flatnonzero(possible)
