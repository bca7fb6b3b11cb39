"""Selection of held-out positions of the artefact: positions that are measured to verify the estimate of the machine's
errors, but are not used for it.

A verification must be able to reveal a wrong estimate. There are two criteria.

`least_known_positions` selects single positions whose balls are expected to keep the largest error after compensation.
An estimate is least certain where no measured position reaches, so a wrong estimate leaves its largest errors there.

`most_informative_groups` selects orientations that are measured at several stations. Assume that the positions used for
the estimate (the position set) leave a part of the error field uncertain and that this part matters for the volumetric
error. A wrong estimate then shows most clearly at the position whose measurement would lower the expected square of the
volumetric compensated error most. The groups are therefore selected by the same criterion as the position set itself.

With both criteria, each selection is made as if all positions selected before had been measured, including those
already held out. Two held-out positions therefore do not test the same error.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from twin.arrays import Array
from twin.design.candidates import CandidatePositions
from twin.errors import DataError

Mask = NDArray[np.bool_]

_EQUAL = 1e-6  # relative difference of expected errors that counts as none, so that rounding does not decide


def least_known_positions(
    candidates: CandidatePositions, chosen: Sequence[int], count: int, is_measurable: Callable[[int], bool]
) -> list[int]:
    """Return the indices of at most `count` candidates whose balls are expected to show the largest error after
    compensation, if the machine's errors are estimated from the candidates `chosen`. The first index is that of the
    candidate with the largest expected error.

    The expected error of a candidate with m balls is trace(W C Wᵀ) / m. Here C is the covariance of the unknowns after
    the candidates `chosen` and the candidates selected before have been measured. It includes the errors that the error
    model cannot represent (misfit). W contains the rows of the candidate's factor without the unknowns of the
    artefact, which are no errors of the machine. The pose of the artefact is eliminated, as in a verification, so an
    error counts only if it deforms the artefact's image. The trace is in units of the variance of a measured ball
    centre.

    Candidates in `chosen`, and candidates for which `is_measurable` returns False, are never selected. `is_measurable`
    is called only for candidates that would be selected. Among equal candidates the first is selected. The list is
    shorter than `count` if fewer candidates can be measured.
    """
    fields = candidates.factors * (candidates.form.raw.diagonal() > 0.0)  # unknowns of the artefact cause no field
    covariance = candidates.covariance(chosen)
    offered = np.ones(candidates.count, dtype=bool)
    offered[list(chosen)] = False
    selected: list[int] = []
    while len(selected) < count:
        errors = np.einsum("nrp,nrp->n", fields @ covariance, fields) / candidates.balls
        best = _first_largest(errors, offered, is_measurable)
        if best is None:
            break
        selected.append(best)
        offered[best] = False
        # C - C Wᵀ (1 + W C Wᵀ)⁻¹ W C with all rows of the measurement
        rows = candidates.factors[best]
        # W C
        carried = rows @ covariance
        covariance = covariance - carried.T @ np.linalg.solve(np.eye(len(rows)) + carried @ rows.T, carried)
    return selected


def _first_largest(errors: Array, offered: Mask, is_measurable: Callable[[int], bool]) -> int | None:
    """Return the index of the largest of the `errors` among the measurable candidates in the mask `offered`, or None if
    there is none. Candidates that cannot be measured are removed from the mask."""
    while offered.any():
        largest = errors[offered].max()
        best = int(np.argmax(offered & (errors >= largest * (1.0 - _EQUAL))))
        if is_measurable(best):
            return best
        offered[best] = False
    return None


def most_informative_groups(
    candidates: CandidatePositions, chosen: Sequence[int], groups: Sequence[Sequence[int]], count: int
) -> list[list[int]]:
    """Return the `count` groups among `groups` whose measurement would improve the estimate of the machine's errors
    most. The groups are selected one after another.

    A group contains the indices of candidates that are measured together, such as one orientation at all stations. A
    group is skipped if it contains a candidate of the position set `chosen`. Raise DataError if fewer than `count`
    groups remain.
    """
    taken = set(chosen)
    left = [list(group) for group in groups if not taken & set(group)]
    if len(left) < count:
        raise DataError(
            f"{count} orientations are to be held out, but only {len(left)} can be measured at the verification's "
            "stations",
            hint="use a finer grid, fewer stations in `verification.stations`, or fewer positions",
        )
    measured, telling = list(chosen), []
    for _ in range(count):
        covariance = candidates.covariance(measured)
        gains = [_gain(candidates.factors[group], candidates.form.aligned, covariance) for group in left]
        best = left.pop(int(np.argmax(gains)))
        telling.append(best)
        measured += best
    return telling


def _gain(factors: Array, form: Array, covariance: Array) -> float:
    """Return the gain of a group of g positions that are measured together. The gain is trace(Q C Wᵀ (1 + W C Wᵀ)⁻¹ W
    C).

    The matrix W stacks the `factors` (g, r, P) of the group, Q is the quadratic form of the criterion, and C is the
    covariance of the unknowns before the group is measured.
    """
    rows = factors.reshape(-1, factors.shape[2])
    carried = rows @ covariance
    taken = np.linalg.solve(np.eye(len(rows)) + carried @ rows.T, carried)
    return float(np.vdot(form @ carried.T, taken.T))
