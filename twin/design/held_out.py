"""Selection of held-out positions of the artefact: positions that are measured to verify the estimate of the machine's
errors, but are not used for it. Positions whose measurement would improve the estimate most are selected.

A verification must be able to reveal a wrong estimate. Assume that the positions used for the estimate (the position
set) leave a part of the error field uncertain and that this part matters for the volumetric error. A wrong estimate
then shows most clearly at the position whose measurement would lower the expected square of the volumetric compensated
error most. Held-out positions are therefore selected by the same criterion as the position set itself. The gain of a
group of positions is computed as if all positions selected before had been measured, including the groups already held
out. Two groups therefore do not test the same error.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from twin.arrays import Array
from twin.design.candidates import CandidatePositions
from twin.errors import DataError


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
