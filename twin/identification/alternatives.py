"""How well the scales are known, and what that does to the estimate.

The measurements say little about some scales, above all about those of misfit that they hardly see. What is stated must
not rest on the likeliest values alone. The log scales are taken as normal about these, with the inverse of the Fisher
information plus that of their priors as covariance (Laplace), and k free scales by k + 1 points of equal weight that
have exactly this mean and covariance (spherical simplex; Julier, Proc. ACC 2003). With V = σ²I + A D⁻¹Aᵀ the Fisher
information of two log variances is half the trace of V⁻¹ ∂V V⁻¹ ∂V', for which the posterior is enough.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from twin.arrays import Array
from twin.identification.evidence import SCALE_PRIORS, free_scales, scaled_blocks
from twin.identification.normal import Posterior, PriorPrecision, Scales


@dataclass(frozen=True, eq=False)
class Alternative:
    """Scales that may be the right ones as well, and what the measurements then say: `z` (P,), `covariance` (P, P)."""

    scales: Scales
    z: Array
    covariance: Array


def alternatives(
    matrix: Array, precision: PriorPrecision, posterior: Posterior, z: Array, scales: Scales, rows: int
) -> tuple[Alternative, ...]:
    """Of equal weight, for the normal `matrix` (P, P) of `rows` equations and the posterior and its mean z (P,) at the
    likeliest `scales`."""
    free = np.array(free_scales(precision))
    spread = np.zeros((int(free.sum()), len(free)))
    spread[:, free] = np.linalg.cholesky(_log_covariance(precision, posterior, scales, rows)[np.ix_(free, free)]).T
    weighted = posterior.times(z) - precision.information_vector
    right = weighted * scales.noise**2
    found = []
    for shift in _simplex(len(spread)) @ spread:
        other = _shifted(scales, shift)
        there = Posterior.of(matrix, precision, other)
        found.append(
            Alternative(other, there.solve(right / other.noise**2 + precision.information_vector), there.covariance)
        )
    return tuple(found)


def mean_and_covariance(found: Sequence[Alternative]) -> tuple[Array, Array]:
    """(P,) and (P, P) over all alternatives together."""
    mean = np.mean([one.z for one in found], axis=0)
    covariance = np.zeros((len(mean), len(mean)))
    for one in found:
        covariance += one.covariance + np.multiply.outer(one.z - mean, one.z - mean)
    return mean, covariance / len(found)


def _log_covariance(precision: PriorPrecision, posterior: Posterior, scales: Scales, rows: int) -> Array:
    """(6, 6) of the log scales; those that are not free have their prior's."""
    prior = precision.matrix(scales)
    kept = posterior.covariance @ prior  # the part of each unknown that is prior; what is left of 1 has been measured
    measured = np.eye(len(kept)) - kept
    information = np.zeros((len(SCALE_PRIORS), len(SCALE_PRIORS)))
    information[0, 0] = rows - len(kept) + float(np.vdot(kept.T, kept))
    noise = np.diagonal(kept) - np.einsum("ab,ba->a", kept, kept)
    blocks = scaled_blocks(precision.blocks)
    for row, one in enumerate(blocks, start=1):
        information[0, row] = information[row, 0] = noise[one].sum()
        for column, other in enumerate(blocks, start=1):
            information[row, column] = float(np.vdot(measured[other, one].T, measured[one, other]))
    deviations = np.array([prior.log_deviation for prior in SCALE_PRIORS])
    return np.asarray(np.linalg.inv(2.0 * information + np.diag(deviations**-2)))


def _shifted(scales: Scales, shift: Array) -> Scales:
    low, high = np.array([prior.bounds for prior in SCALE_PRIORS]).T
    return Scales(*np.exp(np.clip(np.log(scales.values) + shift, low, high)).tolist())


def _simplex(size: int) -> Array:
    """(size + 1, size) points with mean zero and the unit matrix as covariance."""
    centred = np.eye(size + 1) - 1.0 / (size + 1)
    return np.asarray(np.linalg.svd(centred)[0][:, :size] * np.sqrt(size + 1.0))
