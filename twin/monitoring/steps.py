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
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike

from twin.arrays import Array
from twin.monitoring.drift import regression_design

PENALTY_PER_LOG = 6.0
MIN_NIGHTS = 8
MAX_STEPS = 5
MIN_NOISE_SHARE = 1e-3
"""Lower bound of the noise as a share of the stated uncertainty; smaller residuals are rounding errors."""
MEDIAN_RANGE = 0.9539
"""Median of the range of two standard normal values: sqrt(2) times their upper quartile 0.6745."""


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
    gains = {at: _gain(t, y, sigmas, steps, at) for at in _candidates(t, steps)}
    penalty = _penalty(len(t))
    for at in sorted(gains, key=lambda at: -gains[at]):
        if gains[at] < penalty:
            return None
        without = (np.arange(len(t)) != index for index in range(len(t)))
        if all(_gain(t[kept], y[kept], sigmas[kept], steps, at) >= penalty for kept in without):
            return at
    return None


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
        design = regression_design(t, [*kept, at])
        if len(t) > design.shape[1] and np.linalg.matrix_rank(design) == design.shape[1]:
            kept.append(at)
    return tuple(kept)


def _candidates(t: Array, steps: Sequence[float]) -> list[float]:
    """Return the times at which a further step would leave at least two values on each level."""
    edges = [0, *(int(np.searchsorted(t, at)) for at in steps), len(t)]
    return [
        float(t[index])
        for start, end in pairwise(edges)
        for index in range(start + 2, end - 1)
        # values of the same night cannot lie on different sides of a step
        if t[index] > t[index - 1]
    ]


def _gain(t: Array, y: Array, sigmas: Array, steps: Sequence[float], at: float) -> float:
    return _square(t, y, sigmas, steps) - _square(t, y, sigmas, sorted([*steps, at]))


def _square(t: Array, y: Array, sigmas: Array, steps: Sequence[float]) -> float:
    design = regression_design(t, steps) / sigmas[:, None]
    found = np.linalg.lstsq(design, y / sigmas, rcond=None)[0]
    left = y / sigmas - design @ found
    return float(left @ left)
