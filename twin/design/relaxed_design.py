"""Lower bound of the expected error that any set of positions can reach within a given time.

A set measures each of N candidate positions once or not at all. If each may be measured w times instead, with any real
w ≥ 0, the problem of the best set within a time T becomes convex (approximate design; Kiefer, J. R. Stat. Soc. B 21,
1959):

    minimise f(w) = trace(Q C),    C = (D + Σ w W'W)⁻¹,    subject to Σ w t ≤ T,

where D is the prior precision of the unknowns, Q the design criterion, and W and t are the information factor and the
time of each candidate. The derivative of f with respect to one w is -g with g = trace(W C Q C W'). Since f is convex,
no set can reach a smaller value than

    f(w) + Σ w g - T max(g/t)

for any w. The weights are improved by the multiplicative algorithm (Silvey, Titterington and Torsney, Commun. Stat. A
7, 1978), w ← w √(g/t), scaled to the time T, until this bound is close to f(w).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from twin.arrays import Array
from twin.design.candidates import CandidatePositions

_GAP = 0.01  # of f: the bound of the VCE is then within half a percent of the relaxed optimum
_MOST_STEPS = 400
_NEGLIGIBLE = 1e-6  # weight, as a share of the largest, below which a candidate does not contribute


@dataclass(frozen=True)
class InformationBound:
    """Lower bound `vce_mm` of the expected volumetric compensated error (VCE, aligned) in mm that any set of positions
    reaches within `time`, and the VCE `relaxed_mm` of the best weights that were found."""

    time: float
    vce_mm: float
    relaxed_mm: float


def information_bound(candidates: CandidatePositions, times: Array, time: float) -> InformationBound:
    """Return the lower bound for sets of the N `candidates` within `time`. `times` (N,) contains a lower bound of the
    time of each candidate, in the unit of `time`."""
    # Q = R R': the gradient needs W C R only
    values, vectors = np.linalg.eigh(candidates.form.aligned)
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    weights = np.full(candidates.count, time / times.sum())
    bound = 0.0
    for _ in range(_MOST_STEPS):
        covariance = _covariance(candidates, weights)
        value = float(np.vdot(candidates.form.aligned, covariance))
        seen = candidates.factors.reshape(-1, len(root)) @ (covariance @ root)
        gain = np.square(seen).sum(axis=1).reshape(candidates.count, -1).sum(axis=1)
        bound = max(bound, value + float(weights @ gain) - time * float((gain / times).max()))
        if value - bound <= _GAP * value:
            break
        weights = weights * np.sqrt(gain / times)
        weights[weights < _NEGLIGIBLE * weights.max()] = 0.0
        weights *= time / float(weights @ times)
    unresolved = candidates.form.unresolved_mm2
    return InformationBound(time, float(np.sqrt(bound + unresolved)), float(np.sqrt(value + unresolved)))


def _covariance(candidates: CandidatePositions, weights: Array) -> Array:
    used = np.flatnonzero(weights)
    rows = np.sqrt(weights[used])[:, None, None] * candidates.factors[used]
    rows = rows.reshape(-1, rows.shape[2])
    return np.asarray(np.linalg.inv(candidates.precision + rows.T @ rows))
