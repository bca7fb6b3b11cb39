"""Test for a position in which the artefact moved while it was measured.

The balls of a position are measured in the order of its rows. If the artefact slips between two balls, the balls before
and after it have two poses, and half of the balls would be rejected one after the other. The test compares one rigid
pose with two, for each place in the order. Let r be the whitened residuals of the position, C their covariance under
the model, and G (m, 6) the whitened effect of a rigid motion of the later balls alone. The square

    s = gᵀ K⁻¹ g,   g = Gᵀ r,   K = Gᵀ C G

is the gain of the second pose (score test), with errors of the machine and the certificate estimated in the same fit.
It is divided by the common scale of all balls and compared with the F distribution. The probability of a false alarm is
shared by all positions and places (Bonferroni). Single wrong balls have no such effect: a slip must explain more than
the two balls of the position whose removal explains most, which takes as many unknowns.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np
from scipy.special import fdtri

from twin.arrays import Array
from twin.identification.checks.outliers import Rows, WhitenedResiduals
from twin.machine.rigid_motion import rigid_fields

_MIN_BALLS = 3  # on each side: a smaller part has no more freedom as a body than as single balls
_BETTER_THAN_BALLS = 1.5  # gain of the slip over that of the two worst balls
_UNDETERMINED = 1e-8  # relative eigenvalue of K below which a motion is undetermined: the roll of a straight bar


@dataclass(frozen=True)
class Slip:
    """Slip of the artefact before the ball in `row` was measured, and after the ball in `row` - 1.

    `row` is an index into the rows sorted by position. `size_mm` is the rms displacement of the later balls. `gain` is
    the decrease of χ² by the second pose.
    """

    row: int
    size_mm: float
    gain: float


def slip_in(flagged: Rows, found: WhitenedResiduals, false_alarm: float) -> Slip | None:
    """Return the most significant slip in the positions that contain the rows `flagged`, or None.

    `false_alarm` is the probability that a slip is found in a set without one.
    """
    counts = found.counts
    places = max(int(np.maximum(counts - 2 * _MIN_BALLS + 1, 0).sum()), 1)
    share = false_alarm / places
    best: tuple[float, Slip | None] = (0.0, None)
    ends = np.cumsum(counts)
    for position in np.unique(np.searchsorted(ends, flagged, side="right")).tolist():
        first, end = int(ends[position] - counts[position]), int(ends[position])
        candidate = _slip_of(first, end, found, share)
        if candidate is not None and candidate[0] > best[0]:
            best = candidate
    return best[1]


def _slip_of(first: int, end: int, found: WhitenedResiduals, share: float) -> tuple[float, Slip] | None:
    """Return the gain and the slip at the place of the largest gain in one position, or None if it is no slip."""
    size = end - first
    if size < 2 * _MIN_BALLS:
        return None
    rows = slice(first, end)
    residuals, covariance = found.residuals[rows].reshape(-1), found.covariance_of(rows)
    points = found.points[rows]
    middle = points.mean(axis=0)
    motions = rigid_fields(points, middle, float(np.linalg.norm(points - middle, axis=1).max()))
    white = np.einsum("nij,njk->nik", found.whitening[rows], motions)
    gains = []
    for place in range(_MIN_BALLS, size - _MIN_BALLS + 1):
        later = np.where((np.arange(size) >= place)[:, None, None], white, 0.0).reshape(-1, white.shape[2])
        gain, rank, change = _gain(later, residuals, covariance)
        gains.append((gain, rank, place, change))
    gain, rank, place, change = max(gains, key=lambda entry: entry[0])
    limit = rank * float(fdtri(rank, found.degrees_of_freedom, 1.0 - share))
    if gain / found.scale <= max(limit, _BETTER_THAN_BALLS * _worst_pair(residuals, covariance) / found.scale):
        return None
    moved = motions[place:] @ (found.variance * change)
    return gain, Slip(first + place, float(np.sqrt(np.mean(np.sum(moved**2, axis=1)))), gain / found.scale)


def _gain(columns: Array, residuals: Array, covariance: Array) -> tuple[float, int, Array]:
    """Return the gain s of further unknowns with the effects `columns` (m, k), their rank and K⁻¹ g (k,)."""
    score, gram = columns.T @ residuals, columns.T @ covariance @ columns
    values, vectors = np.linalg.eigh(gram)
    seen = values > _UNDETERMINED * values[-1]
    change = vectors[:, seen] @ ((vectors[:, seen].T @ score) / values[seen])
    return float(score @ change), int(seen.sum()), change


def _worst_pair(residuals: Array, covariance: Array) -> float:
    """Return the gain of the two balls whose removal explains most."""
    units = np.eye(len(residuals)).reshape(len(residuals), -1, 3)
    pairs = combinations(range(units.shape[1]), 2)
    return max(_gain(units[:, pair, :].reshape(len(residuals), -1), residuals, covariance)[0] for pair in pairs)
