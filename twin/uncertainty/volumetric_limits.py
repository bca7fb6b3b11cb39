"""Limits of the volumetric error before and after compensation, computed fast enough for every identification.

`twin.uncertainty.volumetric_distribution` gives the distributions themselves, exact to many digits. Here their
quantiles follow from the saddlepoint approximation of Lugannani and Rice (Adv. Appl. Prob. 12, 1980): if K is the
cumulant generating function of a quadratic form Q, and s the saddle at which K'(s) = x, then

    P(Q ≤ x) ≈ Φ(w) + φ(w) (1/w - 1/u),    w = sign(s) √(2 (s x - K(s))),    u = s √K''(s),

with the normal distribution function Φ and its density φ. If s is given instead of x, no equation has to be solved.
The approximation gives the limits to within 0.5 % of the exact distributions.

No measurement of ball centres tells errors of the machine whose wavelength is too short for the misfit modes from noise
of the touches. They are an assumption about the machine, or the scatter of the centres beyond the stated noise, which
may also be touches that scatter more than stated. The upper limits count them in full, the lower limits not at all, so
that the limits hold whichever it is.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import ndtr

from twin.arrays import Array, as_points, as_vector
from twin.identification.estimate import Estimate
from twin.identification.predicted import field_forms
from twin.uncertainty.quadratic_distribution import QuadraticDistribution
from twin.uncertainty.scale_mixture import MixtureComponent, mixture_components
from twin.units import UM_PER_MM

COVERAGE = 0.95
# Zero is left out: there w = u = 0 and 1/w - 1/u is undefined. The linear interpolation closes the gap.
_BELOW = np.concatenate((-np.geomspace(400.0, 4.5, 25), -np.linspace(4.0, 0.1, 20)))
_ABOVE = np.concatenate((np.linspace(0.1, 6.0, 30), np.geomspace(7.0, 40.0, 8)))
"""Saddles in units of one over the standard deviation of Q, below and above its mean."""
_FARTHEST = 6.0  # |w| beyond which a probability is of no use and not accurate
_NO_FIELD = 1e-12  # of the largest eigenvalue of the form
_CERTAIN = 1e-12  # of the largest variance of a direction


@dataclass(frozen=True)
class VolumetricLimits:
    """Lower and upper limits in µm, after the best-fitting rigid motion has been removed: of the volumetric error (VE)
    of the machine without compensation, and of the volumetric compensated error (VCE) with the parameters of the
    estimate as compensation. `expected_ve_um` is the root of the expected mean square without compensation."""

    expected_ve_um: float
    ve_um: tuple[float, float]
    vce_um: tuple[float, float]


def volumetric_limits(estimate: Estimate, points: ArrayLike, tool_offset: ArrayLike) -> VolumetricLimits:
    """Return the limits of the equal-tailed intervals that contain the VE and the VCE with a probability of 95 %.

    The errors are taken over the axis positions `points` (n, 3) in mm. The limits take into account all sets of scales
    that the measurements allow. The upper limits count the unresolved misfit, the lower limits do not.
    """
    grid, offset = as_points(points, "points"), as_vector(tool_offset, 3, "tool offset")
    return limits_of_form(estimate, field_forms(estimate, grid, offset)[1])


def limits_of_form(estimate: Estimate, form: Array) -> VolumetricLimits:
    """Return the limits that `volumetric_limits` returns, from the quadratic form (p + q, p + q) in mm² that gives the
    mean square of the error field after the best-fitting rigid motion has been removed.

    The form applies to the p parameters followed by the q coefficients of the misfit.
    """
    written = np.zeros(len(form))
    written[: estimate.model.size] = estimate.parameters
    root = _root(form)
    likely = mixture_components(estimate)
    parts = [_before_and_after(root, one, written) for one in likely]
    before, after = [one for one, _ in parts], [one for _, one in parts]
    expected_mm2 = float(np.mean([one.mean for one in before]))
    unresolved_mm2 = [_unresolved_mm2(one) for one in likely]
    return VolumetricLimits(
        UM_PER_MM * math.sqrt(expected_mm2), _limits_um(before, unresolved_mm2), _limits_um(after, unresolved_mm2)
    )


def mixture_quantiles(parts: Sequence[QuadraticDistribution], probabilities: ArrayLike) -> Array:
    """Return the quantiles for `probabilities` (m,) of a quadratic form that has each of the distributions `parts` with
    the same weight. For forms of five or more terms, the relative error of their roots is below 0.5 %."""
    curves = [_distribution_function(part) for part in parts]
    values = np.sort(np.concatenate([of_one for of_one, _ in curves]))
    known = np.mean([np.interp(values, *curve, left=0.0, right=1.0) for curve in curves], axis=0)
    return np.asarray(np.interp(np.asarray(probabilities, dtype=np.float64), known, values))


def _root(form: Array) -> Array:
    """Return a matrix B (r, p + q) with BᵀB = `form`; r is the number of directions that change the field at all."""
    units = np.sqrt(np.maximum(np.diagonal(form), 0.0))  # mm and rad, parameters and misfit, differ by many orders
    units = np.where(units > 0.0, units, 1.0)
    values, vectors = np.linalg.eigh(form / np.multiply.outer(units, units))
    kept = values > _NO_FIELD * values[-1]
    return np.asarray(np.sqrt(values[kept])[:, None] * vectors[:, kept].T * units)


def _before_and_after(
    root: Array, one: MixtureComponent, written: Array
) -> tuple[QuadraticDistribution, QuadraticDistribution]:
    """Return the distributions of the mean square, in mm², without compensation and with the compensation `written`.

    If x is the uncertain vector with mean m and covariance P, the mean square is |y|² with y = B x. The eigenvectors v
    of B P Bᵀ and its eigenvalues λ give |y|² = Σ λ (g + δ)², in which the g are standard normal and δ = vᵀ B m / √λ.
    """
    values, vectors = np.linalg.eigh(root @ one.covariance @ root.T)
    known = values > _CERTAIN * max(float(values[-1]), 0.0)
    # Directions without variance add a constant, the square of their mean.
    weights, beside = values[known], _unresolved_mm2(one) + max(float(values[~known].sum()), 0.0)
    found = []
    for mean in (one.mean, one.mean - written):
        along = vectors.T @ (root @ mean)
        found.append(
            QuadraticDistribution(weights, along[known] / np.sqrt(weights), beside + float(np.sum(along[~known] ** 2)))
        )
    return found[0], found[1]


def _unresolved_mm2(one: MixtureComponent) -> float:
    """Return the mean square of the unresolved misfit, which has the same variance in three directions."""
    return 3.0 * one.unresolved_mm2


def _limits_um(parts: Sequence[QuadraticDistribution], unresolved_mm2: Sequence[float]) -> tuple[float, float]:
    """Return the lower and the upper limit in µm. `unresolved_mm2` is the mean square of the unresolved misfit that
    each of the `parts` contains."""
    outside = 0.5 * (1.0 - COVERAGE)
    reduced = [replace(part, least=part.least - absent) for part, absent in zip(parts, unresolved_mm2, strict=True)]
    lower, upper = (
        float(mixture_quantiles(of, (probability,))[0])
        for of, probability in ((reduced, outside), (parts, 1.0 - outside))
    )
    return UM_PER_MM * math.sqrt(max(lower, 0.0)), UM_PER_MM * math.sqrt(max(upper, 0.0))


def _distribution_function(part: QuadraticDistribution) -> tuple[Array, Array]:
    """Return values of the quadratic form in rising order, and the probability that it does not exceed each of them."""
    if not len(part.weights):
        return np.full(2, part.least), np.array([0.0, 1.0])
    spread = math.sqrt(part.variance)
    pole = 0.5 * spread / float(part.weights.max())  # K has its first pole here, in units of 1 / spread
    # a / (1 + a / pole) maps the saddles above the mean from 0 … ∞ to 0 … pole, where K is finite
    saddles = np.concatenate((_BELOW, _ABOVE / (1.0 + _ABOVE / pole))) / spread
    left = 1.0 - 2.0 * np.multiply.outer(saddles, part.weights)
    squares = part.shifts**2
    cumulant = np.sum(-0.5 * np.log(left) + 0.5 * squares * (1.0 - left) / left, axis=1)  # K
    above = np.sum(part.weights / left * (1.0 + squares / left), axis=1)  # K', the value above the lower bound
    curvature = np.sum(2.0 * (part.weights / left) ** 2 * (1.0 + 2.0 * squares / left), axis=1)  # K''
    w = np.sign(saddles) * np.sqrt(2.0 * np.maximum(saddles * above - cumulant, 0.0))
    u = saddles * np.sqrt(curvature)
    near = np.abs(w) < _FARTHEST
    w, u, above = w[near], u[near], above[near]
    probability = ndtr(w) + np.exp(-0.5 * w**2) / math.sqrt(2.0 * math.pi) * (1.0 / w - 1.0 / u)
    # The approximation need not rise everywhere, but the interpolation needs probabilities that do.
    return part.least + above, np.maximum.accumulate(np.clip(probability, 0.0, 1.0))
