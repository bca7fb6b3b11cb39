"""Estimation of the scales of touch noise, prior and each kind of misfit by maximum marginal likelihood (empirical
Bayes).

The equations of the measurement are A z = y with the unknowns z, the design matrix A and the right side y. The poses of
the artefact have been eliminated by projection. After integration over z, twice the negative log marginal likelihood is

    rows ln σ² + |y|²/σ² - rᵀ H⁻¹ r/σ⁴ + ln det H - ln det D,   H = N/σ² + D

(MacKay 1992; Rasmussen and Williams 2006, 5.4). Here `rows` is the number of equations, σ is the touch noise, and D is
the prior precision of z. The matrix N = AᵀA and the right side r = Aᵀy belong to the normal equations. The gradient
with respect to the scales needs only the diagonal of H⁻¹. The logarithm of each scale has a weak normal prior and two
bounds. This prior and the bounds prevent extreme scales if there are few measurements.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from twin.arrays import Array
from twin.identification.misfit import MISFIT_KINDS
from twin.identification.normal import NormalEquations, Posterior, PriorPrecision
from twin.identification.scales import Scales
from twin.machine.kinematic_chain import AXES


@dataclass(frozen=True)
class OrderEvidence:
    """Evidence (marginal likelihood) of a Legendre order of the error model.

    `relative_log` is the log evidence of this order minus the log evidence of the likeliest order that was compared.
    `scales` are the likeliest factors on the standard deviations of noise, prior and misfit for this order. `chosen` is
    True for the order of the estimate.
    """

    order: int
    relative_log: float
    scales: Scales
    chosen: bool


@dataclass(frozen=True)
class ScalePrior:
    """Log-normal prior of a scale.

    `factor` is its geometric standard deviation; `low` and `high` are the bounds of the scale.
    """

    factor: float
    low: float
    high: float

    @property
    def log_deviation(self) -> float:
        return math.log(self.factor)

    @property
    def bounds(self) -> tuple[float, float]:
        return math.log(self.low), math.log(self.high)


NOISE = ScalePrior(3.0, 0.3, 10.0)
PRIOR = ScalePrior(30.0, 0.01, 100.0)  # nearly flat: a machine may be ten times better or worse than its family
MIXED = ScalePrior(3.0, 0.003, 300.0)
WAVES = ScalePrior(2.0, 0.003, 300.0)
MOTION = ScalePrior(1.4, 0.003, 300.0)
SCALE_PRIORS = (NOISE, PRIOR, MIXED, WAVES, WAVES, WAVES, *(MOTION for _ in range(6)))
"""Priors of the scales, in the order of `Scales.values`.

The median is 1 for noise and parameter prior. For the mixed terms and for both parts of the error motions it is the
scale of the parameter prior: a machine that is ten times worse also bends ten times as much. Each axis differs from the
other axes by the factor of `MOTION`. Waves are the high orders of a stationary error, so their median is the scale of
the stationary part of the same axis."""
_OF_ALL_AXES = math.log(2.0)
"""Standard deviation of the log scale of a part of the error motions, for all axes in common."""
_NAMES = (
    *("touch noise", "family prior", *MISFIT_KINDS),
    *(f"{part} errors of {axis}" for part in ("stationary", "independent") for axis in AXES),
)
_BOUND_TOLERANCE = 1e-3  # distance of a log scale from its bound below which it counts as reached
Logs = np.ndarray[tuple[int], np.dtype[np.float64]]

_ACCURACY = 1e-3  # gradient per equation: log scales are accurate to about 0.01, far below their uncertainty


def most_likely_scales(normal: NormalEquations, precision: PriorPrecision, start: Scales) -> Scales:
    """Return the scales that maximise the product of the marginal likelihood and the priors of the scales."""
    return largest_log_evidence(normal, precision, start)[1]


def largest_log_evidence(normal: NormalEquations, precision: PriorPrecision, start: Scales) -> tuple[float, Scales]:
    """Return the largest log evidence, as `log_evidence` defines it, and the scales that maximise it: the factors on
    the standard deviations of noise, prior and misfit. The search begins at the scales `start`."""
    # Takes 0.3 s to import, and most commands identify nothing.
    from scipy.optimize import minimize  # noqa: PLC0415

    normal, precision = in_principal_axes(normal, precision)
    free = free_scales(precision)
    log_start: Logs = np.log(start.values)[free]
    cost = _cost(normal, precision, start)
    bounds = [prior.bounds for prior, used in zip(SCALE_PRIORS, free, strict=True) if used]
    found = minimize(
        cost,
        log_start,
        method="L-BFGS-B",
        jac=True,
        bounds=bounds,
        options={"maxiter": 40, "gtol": _ACCURACY, "ftol": 1e-10},
    )
    return _log_evidence(float(found.fun), normal), _scales(np.asarray(found.x), free, start)


def log_evidence(normal: NormalEquations, precision: PriorPrecision, scales: Scales) -> float:
    """Return the logarithm of the product of the marginal likelihood and the priors of `scales`. Terms that depend only
    on the measured rows and their covariances are omitted."""
    normal, precision = in_principal_axes(normal, precision)
    logs = np.log(scales.values)[free_scales(precision)]
    return _log_evidence(_cost(normal, precision, scales)(logs)[0], normal)


def _log_evidence(cost: float, normal: NormalEquations) -> float:
    """Return the log evidence of a value of the cost that the search for scales minimises."""
    return -0.5 * cost * normal.rows


def scales_at_bounds(scales: Scales) -> tuple[str, ...]:
    """Return a description of each scale that reached its lower or upper bound."""
    found = []
    for name, value, prior in zip(_NAMES, scales.values, SCALE_PRIORS, strict=True):
        for bound in (prior.low, prior.high):
            if abs(math.log(value / bound)) < _BOUND_TOLERANCE:
                found.append(f"{name}: {bound:g} times as stated, the bound of its scale")
    return tuple(found)


def free_scales(precision: PriorPrecision) -> list[bool]:
    """Return one flag for each scale, in the order of `Scales.values`. It is False if a carried-over prior fixes the
    scale or if the scale applies to no unknown, and True otherwise."""
    kinds = [precision.has_free_scale(block) for block in precision.blocks.kinds]
    kinds += [False] * (len(MISFIT_KINDS) - len(kinds))
    series = precision.series is not None or precision.principal is not None
    return [True, precision.has_free_scale(precision.blocks.parameters), *kinds, *([series] * 6)]


def _scales(logs: Array, free: list[bool], others: Scales) -> Scales:
    values = np.array(others.values)
    values[free] = np.exp(logs)
    return Scales(*values.tolist())


def _cost(normal: NormalEquations, precision: PriorPrecision, others: Scales) -> Callable[[Logs], tuple[float, Array]]:
    free = free_scales(precision)
    prior = log_scale_precision()

    def cost(logs: Logs) -> tuple[float, Array]:
        scales = _scales(logs, free, others)
        value, gradient = negative_log_likelihood(normal, precision, scales)
        # A fixed scale stays in the joint prior, because the others are distributed about it. The division by the
        # number of equations makes the tolerance of the search independent of the size of the set.
        every = np.log(scales.values)
        pull = prior @ every
        return (value + float(every @ pull)) / normal.rows, (gradient + 2.0 * pull)[free] / normal.rows

    return cost


@cache
def log_scale_precision() -> Array:
    """Return the precision (12, 12) of the joint normal prior of the log scales, whose mean is zero.

    `SCALE_PRIORS` states about which scale each of them is distributed.
    """
    # each row: independent normal variables whose sum is the log scale
    waves, stationary, independent = slice(3, 6), slice(6, 9), slice(9, 12)
    mixing = np.hstack((np.diag([prior.log_deviation for prior in SCALE_PRIORS]), np.zeros((len(SCALE_PRIORS), 2))))
    mixing[2:, 1] = PRIOR.log_deviation
    mixing[stationary, -2] = mixing[independent, -1] = _OF_ALL_AXES
    mixing[waves] += mixing[stationary]
    mixing[waves, 1] = PRIOR.log_deviation
    return np.asarray(np.linalg.inv(mixing @ mixing.T))


def negative_log_likelihood(normal: NormalEquations, precision: PriorPrecision, scales: Scales) -> tuple[float, Array]:
    """Return twice the negative log marginal likelihood, up to a constant, and its derivatives (12,) with respect to
    the logarithms of the scales, in the order of `Scales.values`.

    The prior precision must be diagonal: see `in_principal_axes`.
    """
    variance = scales.noise**2
    posterior = Posterior.of(normal.matrix, precision, scales)
    value, z = deviance(normal, precision, scales, posterior)
    variances, diagonal = posterior.variances, precision.diagonal(scales)
    weighted_z, trace = diagonal * z, float(variances @ diagonal)
    gradient = np.zeros(len(SCALE_PRIORS))
    # The derivative of ln det H gives tr(H⁻¹ N/σ²) = P - tr(H⁻¹ D), the effective number of parameters (MacKay's γ).
    # The quadratic terms are stationary in z, so only the explicit σ in |y - A z|²/σ² counts.
    gradient[0] = 2.0 * (normal.rows - (len(z) - trace) - normal.misfit_square(z) / variance)
    # derivatives with respect to the prior variances: D - D C D - D z zᵀ D, of which only the diagonal counts
    gradient[1:] = precision.variance_changes(scales) @ (diagonal - diagonal**2 * variances - weighted_z**2)
    return value, gradient


def deviance(
    normal: NormalEquations, precision: PriorPrecision, scales: Scales, posterior: Posterior
) -> tuple[float, Array]:
    """Return twice the negative log marginal likelihood at the given scales, up to a constant, and the posterior mean
    (P,) of the unknowns. `posterior` is their posterior at these scales."""
    variance = scales.noise**2
    right = normal.right / variance + precision.information_vector
    z = posterior.solve(right)
    # rows ln σ² + |y|²/σ² - rᵀH⁻¹r (with r the weighted right side) + ln det H - ln det D
    # Dropped: rows ln 2π and, for a joint prior with mean m and precision K, mᵀ K m; no scale changes either of them.
    value = normal.rows * math.log(variance) + normal.square / variance - float(right @ z)
    return value + posterior.log_determinant - precision.log_determinant(scales), z


def in_principal_axes(normal: NormalEquations, precision: PriorPrecision) -> tuple[NormalEquations, PriorPrecision]:
    """Return the same equations, prior and direct information for unknowns in the principal axes of the stationary part
    of the error motions and of the joint prior, in which the prior precision is diagonal."""
    series, known = precision.series, precision.known
    if series is None and known is None:
        return normal, precision
    size = precision.blocks.size
    rotation, principal = np.eye(size), precision.principal
    if series is not None:
        rotation, principal = series.rotation(size), series.in_principal_axes(size)
    if known is not None:
        known, axes = known.in_principal_axes()
        rotation[:, known.members] = rotation[:, known.members] @ axes
    turned = replace(normal, matrix=rotation.T @ normal.matrix @ rotation, right=rotation.T @ normal.right)
    direct = precision.direct
    direct = None if direct is None else replace(direct, rows=direct.rows @ rotation)
    return turned, replace(precision, series=None, principal=principal, known=known, direct=direct)
