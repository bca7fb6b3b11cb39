"""Uncertainty of the estimated scales of an identification, and its effect on the estimate.

A scale is a factor on the standard deviation of the touch noise, of the prior or of a kind of misfit. The measurements
determine some scales poorly, above all the scale of a kind of misfit that they hardly observe. The stated result must
therefore not depend on the likeliest scales alone. The logarithms of the scales are assumed to be normally distributed
about their likeliest values (Laplace approximation). The precision of this normal distribution is the sum of the Fisher
information and the precision of the priors of the scales. The k free scales are represented by k + 1 points of equal
weight that have exactly this mean and covariance (spherical simplex; Julier, Proc. ACC 2003).

The measurements have the covariance V = σ²I + A D⁻¹Aᵀ, where σ is the touch noise, I the unit matrix, A the design
matrix and D the prior precision. The Fisher information of two log variances is half the trace of V⁻¹ ∂V V⁻¹ ∂V'. Here
∂V is the derivative of V with respect to the first log variance, and ∂V' is the derivative with respect to the second.
The Fisher information can be computed from the posterior alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from twin.arrays import Array
from twin.identification.evidence import SCALE_PRIORS, free_scales, log_scale_precision
from twin.identification.normal import Posterior, PriorPrecision
from twin.identification.scales import Scales

_STATIONARY = 6  # number of the scale of the stationary part in `Scales.values`


@dataclass(frozen=True, eq=False)
class Alternative:
    """Plausible scales near the likeliest scales, with the posterior mean `z` (P,) and the posterior `covariance` (P,
    P) of the P unknowns of an identification at the plausible scales."""

    scales: Scales
    z: Array
    covariance: Array


def alternatives(
    matrix: Array, precision: PriorPrecision, posterior: Posterior, z: Array, scales: Scales, rows: int
) -> tuple[Alternative, ...]:
    """Return alternatives of equal weight that represent the uncertainty of the scales. Each alternative contains
    plausible scales with the corresponding estimate.

    `scales` are the likeliest scales. `posterior` is the posterior of the P unknowns at these scales, and `z` (P,) is
    its mean. `matrix` (P, P) is the matrix of the normal equations, which are formed from `rows` observation equations.
    """
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
    """Return the mean (P,) and the covariance (P, P) of the P unknowns over the mixture of all alternatives `found`.
    Each alternative is an estimate for other plausible standard deviations; all have equal weight."""
    mean = np.mean([one.z for one in found], axis=0)
    covariance = np.zeros((len(mean), len(mean)))
    for one in found:
        covariance += one.covariance + np.multiply.outer(one.z - mean, one.z - mean)
    return mean, covariance / len(found)


def _log_covariance(precision: PriorPrecision, posterior: Posterior, scales: Scales, rows: int) -> Array:
    """Return the covariance (8, 8) of the log scales. A scale that applies to no unknown has its prior variance."""
    # D C: share of each unknown that comes from the prior; AᵀV⁻¹A = D - D C D; σ² AᵀV⁻²A = D C D - D C D C D
    kept = precision.times(posterior.covariance, scales)
    measured = precision.times(np.eye(len(kept)) - kept.T, scales)
    noisy = kept @ measured
    information = np.zeros((len(SCALE_PRIORS), len(SCALE_PRIORS)))
    information[0, 0] = rows - len(kept) + float(np.vdot(kept.T, kept))
    # half traces with the derivatives of the prior covariance by the log scales, a quarter for log variances
    changes = precision.variance_changes(scales)
    information[0, 1:] = information[1:, 0] = 0.5 * changes @ np.diagonal(noisy)
    information[1:, 1:] = 0.25 * changes @ measured**2 @ changes.T
    if precision.series is not None:
        series = precision.series
        change = 2.0 * scales.stationary**2 * series.kernel
        through = np.zeros_like(measured)
        series.put_product(change, measured, through)
        information[0, _STATIONARY] = information[_STATIONARY, 0] = 0.5 * float(np.vdot(series.parts(noisy), change))
        information[_STATIONARY, _STATIONARY] = 0.25 * float(np.vdot(through.T, through))
        # diagonal of G ∂Σ G for the symmetric G = D - D C D
        others = np.flatnonzero(np.arange(len(changes)) != _STATIONARY - 1)
        both = 0.25 * changes[others] @ np.einsum("ij,ij->j", measured, through)
        information[others + 1, _STATIONARY] = information[_STATIONARY, others + 1] = both
    return np.asarray(np.linalg.inv(2.0 * information + log_scale_precision()))


def _shifted(scales: Scales, shift: Array) -> Scales:
    low, high = np.array([prior.bounds for prior in SCALE_PRIORS]).T
    return Scales(*np.exp(np.clip(np.log(scales.values) + shift, low, high)).tolist())


def _simplex(size: int) -> Array:
    """Return n + 1 points as an array (n + 1, n) with mean zero and unit covariance, where n is `size`."""
    centred = np.eye(size + 1) - 1.0 / (size + 1)
    return np.asarray(np.linalg.svd(centred)[0][:, :size] * np.sqrt(size + 1.0))
