"""Test of the scale that all linear axes have in common, against what is known of machine and artefact beforehand.

A free artefact shows the scale of the machine minus that of the artefact: a strain ε of all balls and an additional
slope ε of EXX, EYY and EZZ change the measurements in the same way. So an artefact that is ε longer than its file and
its thermometer state looks like a machine whose three axes have the scale error -ε in common, and the table would
write this error into the machine. What is observed is, for each axis, the difference

    q = s - a

of the slope s of its positioning error and of the strain a of the artefact beyond what is stated. Before the
measurement, s has the variance of the family of machines, and a that of the thermometer, of the coefficient of thermal
expansion (CTE) and of the certified lengths, all taken together. With the prior covariance V (3, 3) of q and its
posterior covariance C, the posterior mean m of q is normally distributed with mean zero and covariance G = V - C if the
statements are right (law of total variance). With the vector 1 of three ones, a common scale is estimated by

    w'm,   w = G⁻¹1 / 1'G⁻¹1,

in which an axis has the more weight the less its family lets it vary, and w'm has the variance 1 / 1'G⁻¹1. A scale of
one axis alone is no common one: no artefact explains it, and a table may correct it. If such a scale explains m better,
that is, if it decreases m'G⁻¹m by more, the probability counts as 1. The false alarm probability is therefore at most
the stated one.

Machines may be many times worse than their family in all errors. The scales of the family are therefore estimated
without the slopes of the three positioning errors, which would otherwise explain themselves, but no scale is below 1.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import ndtr

from twin.arrays import Array
from twin.artefact.certificate import farthest_pairs
from twin.identification.evidence import most_likely_scales
from twin.identification.normal import NormalEquations, Posterior, PriorPrecision
from twin.identification.problem import IdentificationProblem
from twin.identification.scales import Scales
from twin.identification.solution import Solution
from twin.machine.kinematic_chain import AXES
from twin.machine.rigid_motion import rigid_fields
from twin.units import UM_PER_MM

_FREE = 100.0  # times the family: standard deviation of a slope that takes no part in the estimate of the scales
_UNSEEN = 1e-3  # share of the prior covariance that is added to G: a scale that was not measured is not tested
_REACHED = 1e-3  # relative deviation up to which the certificate's uncertainty contains a strain of the artefact
_CERTAIN = 1e-9  # of the largest eigenvalue of the prior covariance
_EQUAL = 1e-9  # relative difference of two gains that is due to rounding
_COLD_K = 0.05  # nearer to the reference temperature, no CTE explains a strain
_UM_PER_M = 1e6


@dataclass(frozen=True)
class CommonScale:
    """Scale that EXX, EYY and EZZ have in common relative to the artefact, in µm/m, and what would explain it.

    `scale_um_per_m` is the weighted mean of the linear terms `axes_um_per_m` of the three axes,
    `standard_uncertainty_um_per_m` its standard uncertainty from the measurement, and `expected_um_per_m` its standard
    deviation beforehand, from the family of machines and the stated uncertainties of the artefact together.
    `false_alarm` is the largest probability of such a scale if these are right.

    One of the following errors alone would explain the scale; each is the stated or read value minus the true one.
    `temperature_k` is the error of the artefact's temperature in K, `length_um` that of the distance `length_mm` of the
    two balls that are farthest apart, and `cte_per_k` that of its CTE in 1/K. A value is None if it explains nothing.
    """

    scale_um_per_m: float
    standard_uncertainty_um_per_m: float
    expected_um_per_m: float
    axes_um_per_m: tuple[float, float, float]
    false_alarm: float
    temperature_k: float | None
    length_um: float
    length_mm: float
    cte_per_k: float | None

    @property
    def text(self) -> str:
        """The scale in words, with what was expected of it."""
        axes = ", ".join(f"E{axis}{axis} {value:+.1f}" for axis, value in zip(AXES, self.axes_um_per_m, strict=True))
        return (
            f"a common scale of {self.scale_um_per_m:+.1f} ± {2.0 * self.standard_uncertainty_um_per_m:.1f} µm/m "
            f"({axes}); the family and the stated uncertainties give 0 ± {2.0 * self.expected_um_per_m:.1f} µm/m "
            "(k = 2)"
        )

    @property
    def causes(self) -> str:
        """The errors that would explain the scale, in words."""
        causes = []
        if self.temperature_k is not None:
            causes.append(f"an artefact temperature {_wrong(self.temperature_k, 'high', 'low', '.2f')} K")
        length = _wrong(self.length_um, "long", "short", ".1f")
        causes.append(f"an artefact length {length} µm over {self.length_mm:.0f} mm")
        if self.cte_per_k is not None:
            causes.append(f"a CTE {_wrong(self.cte_per_k, 'large', 'small', '.2g')} 1/K")
        return f"{', '.join(causes[:-1])} or {causes[-1]}" if len(causes) > 1 else causes[0]


def _wrong(error: float, above: str, below: str, digits: str) -> str:
    return f"too {above if error > 0.0 else below} by {abs(error):{digits}}"


def common_scale(solution: Solution) -> CommonScale:
    """Test the common scale in a solution with the family as prior, in the formulation of ball centres.

    Readings of other instruments that are part of the solution do not take part in the test."""
    problem, normal = solution.equations.problem, _normal_equations(solution)
    # The test is about what the artefact shows: readings of other instruments measure the same slopes, but no strain.
    precision = replace(solution.precision, direct=None)
    scales = _scales(problem, normal, precision, solution)
    posterior = Posterior.of(normal.matrix, precision, scales)
    mean = posterior.solve(normal.right / scales.noise**2 + precision.information_vector)
    prior = Posterior.of(np.zeros_like(normal.matrix), precision, replace(scales, noise=1.0))
    observed = _observed(problem, prior)
    before, after = (observed @ one.solve(observed.T) for one in (prior, posterior))
    axes = observed @ mean
    test = _MeanOfAxes.of(axes, before, before - after)
    errors = problem.unknowns.artefact
    first, last = farthest_pairs(errors.balls)[0]
    length_mm = float(np.linalg.norm(errors.balls[last] - errors.balls[first]))
    warmer_k = float(problem.nuisance.warmer_k.mean())
    x, y, z = (_UM_PER_M * axes).tolist()
    return CommonScale(
        scale_um_per_m=_UM_PER_M * test.scale,
        standard_uncertainty_um_per_m=_UM_PER_M * test.deviation(after),
        expected_um_per_m=_UM_PER_M * test.deviation(before),
        axes_um_per_m=(x, y, z),
        false_alarm=test.false_alarm,
        temperature_k=test.scale / errors.cte_per_k if errors.cte_per_k > 0.0 else None,
        length_um=UM_PER_MM * test.scale * length_mm,
        length_mm=length_mm,
        cte_per_k=test.scale / warmer_k if abs(warmer_k) > _COLD_K else None,
    )


@dataclass(frozen=True, eq=False)
class _MeanOfAxes:
    """Common scale w'm of the three axes, with the weights w (3,), and its false alarm probability."""

    scale: float
    weights: Array
    false_alarm: float

    @classmethod
    def of(cls, axes: Array, before: Array, explained: Array) -> _MeanOfAxes:
        """Return the common scale of the posterior means `axes` (3,), whose covariance is `explained` (3, 3) if the
        prior covariance `before` (3, 3) is right."""
        if not before.any():
            return cls(float(axes.mean()), np.full(3, 1.0 / 3.0), 1.0)
        inverse = np.linalg.pinv(explained + _UNSEEN * before, rcond=_CERTAIN, hermitian=True)
        common, weighted = inverse.sum(axis=1), inverse @ axes
        gain = float(common @ axes) ** 2 / float(common.sum())
        variances = np.diagonal(inverse)
        single = np.divide(weighted**2, variances, out=np.zeros(3), where=variances > 0.0)
        is_common = gain >= (1.0 - _EQUAL) * float(single.max())
        weights = common / common.sum()
        return cls(float(weights @ axes), weights, 2.0 * float(ndtr(-math.sqrt(gain))) if is_common else 1.0)

    def deviation(self, covariance: Array) -> float:
        """Return the standard deviation of the mean for a covariance (3, 3) of the axes."""
        return math.sqrt(max(float(self.weights @ covariance @ self.weights), 0.0))


def _normal_equations(solution: Solution) -> NormalEquations:
    """Return the normal equations of the ball centres with the right side of the last iteration."""
    variance, z = solution.scales.noise**2, solution.z
    matrix, rows = solution.equations.matrix, solution.equations.rows
    right = (solution.posterior.times(z) - solution.precision.information_vector) * variance
    left = solution.chi2 * solution.degrees_of_freedom
    return NormalEquations(matrix, right, left + 2.0 * float(right @ z) - float(z @ matrix @ z), rows)


def _slopes(problem: IdentificationProblem) -> tuple[np.ndarray, Array]:
    """Return the unknowns (k,) that are the linear terms of the positioning errors, and their slopes (3, k) per unit of
    each unknown. An axis without such a term has no slope."""
    unknowns = problem.unknowns
    model = unknowns.model
    columns, rows = list[int](), list[Array]()
    for axis, name in enumerate(AXES):
        low, high = model.ranges_mm[axis]
        for index, parameter in enumerate(model.parameters):
            if parameter.error == f"E{name}{name}" and parameter.order == 1 and unknowns.scale[index] > 0.0:
                # P1 rises from -1 to 1 over the travel
                columns.append(index)
                rows.append(2.0 / (high - low) * unknowns.scale[index] * np.eye(3)[axis])
    return np.array(columns, dtype=np.int64), np.array(rows).reshape(-1, 3).T


def _observed(problem: IdentificationProblem, prior: Posterior) -> Array:
    """Return the matrix (3, P) that gives q of the three axes from the unknowns."""
    blocks = problem.blocks
    columns, slopes = _slopes(problem)
    found = np.zeros((3, blocks.size))
    found[:, columns] = slopes
    found[:, blocks.strain] -= problem.nuisance.strain_rows.mean(axis=0)
    found[:, blocks.certificate] -= _certified_strain(problem, prior)
    return found


def _certified_strain(problem: IdentificationProblem, prior: Posterior) -> Array:
    """Return the linear function (m,) of the m unknown errors of the certificate that gives the strain of the artefact
    with the smallest prior variance. It is zero for errors that are rigid motions, and zero altogether if the
    certificate contains no uncertainty of the scale."""
    errors, block = problem.unknowns.artefact, problem.blocks.certificate
    factor = errors.certificate
    if factor.shape[1] == 0:
        return np.zeros(0)
    arms = errors.balls - errors.balls.mean(axis=0)
    motions = rigid_fields(arms, np.zeros(3), float(np.abs(arms).max())).reshape(-1, 6)
    wanted = np.column_stack((arms.reshape(-1), motions))
    # unknowns u that displace the balls by each column: L u = column
    fields = np.linalg.lstsq(factor, wanted, rcond=1e-12)[0]
    if np.linalg.norm(factor @ fields[:, 0] - wanted[:, 0]) > _REACHED * np.linalg.norm(wanted[:, 0]):
        return np.zeros(factor.shape[1])
    precision = (prior.factor @ prior.factor.T)[block, block]
    weighted = precision @ fields
    return np.asarray(weighted @ np.linalg.pinv(fields.T @ weighted)[0])


def _scales(
    problem: IdentificationProblem, normal: NormalEquations, precision: PriorPrecision, solution: Solution
) -> Scales:
    """Return the scales of noise, family and misfit that the measurements support apart from the slopes. The scales of
    the family are at least 1."""
    scales = solution.scales
    if solution.scales_estimated:
        widening = np.ones(problem.blocks.size)
        widening[_slopes(problem)[0]] = _FREE
        matrix = normal.matrix * np.multiply.outer(widening, widening)
        free = NormalEquations(matrix, normal.right * widening, normal.square, normal.rows)
        scales = most_likely_scales(free, precision, scales)
    noise, prior, *kinds = scales.values[:6]
    return Scales(noise, max(prior, 1.0), *kinds, *(max(scale, 1.0) for scale in scales.values[6:]))
