"""Which positions to hold out for the proof: those that would have told most of what the set leaves.

The proof should be able to fail. Where a set has left the field uncertain, and where that matters for the volumetric
error, a further position would lower the expected VCE² most; there an estimate that is wrong shows most clearly. So the
criterion is that of the set itself, carried on after it: the gain of each group of positions, given everything chosen
before, the groups already held out included, so that two of them do not look at the same thing.
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
    """The best `count` of `groups` (indices measured together, such as one orientation at all stations), one after the
    other. Groups that share a position with `chosen` are left out. DataError where too few are left."""
    taken = set(chosen)
    left = [list(group) for group in groups if not taken & set(group)]
    if len(left) < count:
        raise DataError(
            f"{count} orientations are to be held out, {len(left)} are left that the verification's stations reach",
            hint="take a finer grid, fewer stations in `verification.stations`, or fewer positions",
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
    """trace(Q C Wᵀ (1 + W C Wᵀ)⁻¹ W C) of factors (g, r, P) measured together."""
    rows = factors.reshape(-1, factors.shape[2])
    carried = rows @ covariance
    taken = np.linalg.solve(np.eye(len(rows)) + carried @ rows.T, carried)
    return float(np.vdot(form @ carried.T, taken.T))
