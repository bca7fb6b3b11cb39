"""Uncertainty of the estimated scales of an identification, and its effect on the estimate.

A scale is a factor on the standard deviation of the touch noise, of the prior or of a kind of misfit. The measurements
determine some scales poorly, above all the scale of a kind of misfit that they hardly observe. The stated result must
therefore not depend on the likeliest scales alone. The logarithms of the scales are first assumed to be normally
distributed about their likeliest values (Laplace approximation). The precision of this normal distribution is the sum
of the Fisher information and the precision of the priors of the scales. A pair of points on each of its k principal
axes, at √k standard deviations from the centre and of equal weight, has exactly its mean and covariance.

The true distribution is skewed: a scale whose errors are not seen can be far smaller than its likeliest value, but
hardly larger. Each point is therefore moved along its axis until the density there is that of a normal distribution at
√k standard deviations, as in the integrated nested Laplace approximation (Rue, Martino and Chopin, J. R. Statist. Soc.
B 71, 2009, 6.5).

The measurements have the covariance V = σ²I + A D⁻¹Aᵀ, where σ is the touch noise, I the unit matrix, A the design
matrix and D the prior precision. The Fisher information of two log variances is half the trace of V⁻¹ ∂V V⁻¹ ∂V'. Here
∂V is the derivative of V with respect to the first log variance, and ∂V' is the derivative with respect to the second.
The Fisher information can be computed from the posterior alone.

Readings of other instruments (`PriorPrecision.direct`) belong to the estimate at each point, but say nothing about the
scales: an instrument sees one error along one line, and a scale stands for all errors of an axis.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from twin.arrays import Array
from twin.identification.evidence import SCALE_PRIORS, deviance, free_scales, log_scale_precision
from twin.identification.normal import NormalEquations, Posterior, PriorPrecision
from twin.identification.scales import Scales

_STATIONARY = slice(6, 9)  # numbers of the scales of the stationary parts in `Scales.values`
_NEAREST, _FARTHEST = 0.2, 2.0  # bounds of the factor on the distance of a point from the centre


@dataclass(frozen=True, eq=False)
class Alternative:
    """Plausible scales near the likeliest scales, with the posterior mean `z` (P,) and the posterior `covariance` (P,
    P) of the P unknowns of an identification at the plausible scales."""

    scales: Scales
    z: Array
    covariance: Array


def alternatives(
    normal: NormalEquations, precision: PriorPrecision, posterior: Posterior, scales: Scales
) -> tuple[Alternative, ...]:
    """Return alternatives of equal weight that represent the uncertainty of the scales. Each alternative contains
    plausible scales with the corresponding estimate.

    `scales` are the likeliest scales, and `posterior` is the posterior of the P unknowns at these scales.
    """
    whole = precision
    if precision.direct is not None:
        precision = replace(precision, direct=None)
        posterior = Posterior.of(normal.matrix, precision, scales)
    free = np.array(free_scales(precision))
    information = _log_information(normal.rows, precision, posterior, scales)[np.ix_(free, free)]
    variances, axes = np.linalg.eigh(np.linalg.inv(information))
    at_centre = _cost(normal, precision, scales, posterior)
    found = []
    for variance, axis in zip(variances, axes.T, strict=True):
        away = np.zeros(len(free))
        away[free] = math.sqrt(len(axes) * variance) * axis
        for side in (away, -away):
            at_side = _shifted(scales, side)
            there = Posterior.of(normal.matrix, precision, at_side)
            rise = _cost(normal, precision, at_side, there) - at_centre
            # twice the negative log density of a normal distribution rises by k at √k standard deviations
            factor = math.sqrt(len(axes) / rise) if rise > 0.0 else _FARTHEST
            other = _shifted(scales, min(max(factor, _NEAREST), _FARTHEST) * side)
            there = Posterior.of(normal.matrix, whole, other)
            found.append(Alternative(other, deviance(normal, whole, other, there)[1], there.covariance))
    return tuple(found)


def mean_and_covariance(found: Sequence[Alternative]) -> tuple[Array, Array]:
    """Return the mean (P,) and the covariance (P, P) of the P unknowns over the mixture of all alternatives `found`.
    Each alternative is an estimate for other plausible standard deviations; all have equal weight."""
    mean = np.mean([one.z for one in found], axis=0)
    covariance = np.zeros((len(mean), len(mean)))
    for one in found:
        covariance += one.covariance + np.multiply.outer(one.z - mean, one.z - mean)
    return mean, covariance / len(found)


def _cost(normal: NormalEquations, precision: PriorPrecision, scales: Scales, posterior: Posterior) -> float:
    """Return twice the negative log density of the scales, up to a constant."""
    logs = np.log(scales.values)
    return deviance(normal, precision, scales, posterior)[0] + float(logs @ log_scale_precision() @ logs)


def _log_information(rows: int, precision: PriorPrecision, posterior: Posterior, scales: Scales) -> Array:
    """Return the precision (12, 12) of the log scales."""
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
        change = 2.0 * np.square(scales.stationary)[series.axis, None, None] * series.kernel
        through = np.zeros_like(measured)
        series.put_product(change, measured, through)
        traces = np.einsum("bij,bij->b", series.parts(noisy), change)
        information[0, _STATIONARY] = 0.5 * np.bincount(series.axis, weights=traces, minlength=3)
        information[_STATIONARY, 0] = information[0, _STATIONARY]
        # The rows of `through` are those of ∂Σ G, with the symmetric G = D - D C D, for the axis that each belongs to.
        of_axis = (series.axes(len(kept)) == np.arange(3)[:, None]).astype(float)
        information[_STATIONARY, _STATIONARY] = 0.25 * of_axis @ (through * through.T) @ of_axis.T
        # diagonal of G ∂Σ G
        others = np.r_[1 : _STATIONARY.start, _STATIONARY.stop : len(information)]
        both = 0.25 * changes[others - 1] @ (of_axis @ (measured * through)).T
        information[others, _STATIONARY], information[_STATIONARY, others] = both, both.T
    return np.asarray(2.0 * information + log_scale_precision())


def _shifted(scales: Scales, shift: Array) -> Scales:
    low, high = np.array([prior.bounds for prior in SCALE_PRIORS]).T
    return Scales(*np.exp(np.clip(np.log(scales.values) + shift, low, high)).tolist())
