"""Coverage of stated uncertainty regions, observed on simulated machines whose true errors are known.

An uncertainty region, such as an interval, is stated for a nominal level, for example 95 %. Each comparison of an
estimate with the truth is reduced to one number: the level of the region whose boundary passes through the true value.
If the regions are stated correctly, these levels are uniformly distributed between 0 and 1 over many machines. The
fraction of levels that do not exceed 0.95 is the observed coverage of the 95 % regions.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from scipy.special import chdtr, ndtr

from twin.arrays import Array
from twin.artefact.artefact import Artefact
from twin.artefact.observations import Observations
from twin.identification import Estimate, Options
from twin.identification.poses import rigid_poses
from twin.identification.predicted import field_columns, unresolved_variance
from twin.identification.problem import IdentificationProblem, build_problem
from twin.machine.forward_model import exact_deviation
from twin.machine.machine_population import Family
from twin.machine.rigid_motion import rigid_fields
from twin.machine.volumetric import volumetric_error
from twin.uncertainty.volumetric_distribution import aligned_distributions

_MIN_VARIANCE = 1e-9  # of the largest variance: directions below were removed with the rigid motion
# The standard error that the bootstrap gives is itself uncertain by 1/√(2 · 2000), 1.6 %.
_RESAMPLES = 2000


class TrueField(Protocol):
    """Machine whose true error field is known."""

    @property
    def tool_offset(self) -> Array:
        """Vector (3,) in mm from the reference point of the ram to the tool centre point."""
        ...

    def deviation(self, axis_positions: Array, /) -> Array:
        """Return the true deviation (n, 3) in mm of the tool centre point at axis positions (n, 3) in mm."""
        ...


@dataclass(frozen=True)
class ObservedCoverage:
    """Observed coverage of stated uncertainty regions over all simulated machines, and its standard error.

    `observed` is the fraction of the comparisons of an estimate with the truth in which the uncertainty region contains
    the true value.
    """

    observed: float
    standard_error: float


def observed_coverage(levels: Sequence[Array], nominal: float, rng: np.random.Generator) -> ObservedCoverage:
    """Return the observed coverage of the uncertainty regions stated for the level `nominal`, for example 0.95.

    `levels` contains one array, shape (m,), for each machine: the levels of its m comparisons of an estimate with the
    truth. The level of a comparison is the level of the uncertainty region whose boundary passes through the true
    value. The standard error is obtained by resampling whole machines with replacement (bootstrap), since the
    comparisons of one machine are correlated.
    """
    held = np.array([np.count_nonzero(one <= nominal) for one in levels], dtype=np.float64)
    counts = np.array([np.size(one) for one in levels], dtype=np.float64)
    # A resample of machines with replacement is given by the number of times that each machine occurs in it.
    drawn = rng.multinomial(len(levels), np.full(len(levels), 1.0 / len(levels)), size=_RESAMPLES)
    again = (drawn @ held) / (drawn @ counts)
    return ObservedCoverage(float(held.sum() / counts.sum()), float(again.std()))


@dataclass(frozen=True, eq=False)
class FieldError:
    """Error of the estimated field of deviations at n points: the true deviation minus the expected one.

    The best-fitting rigid motion has been removed from the error, because no artefact can determine this motion.
    `error`, shape (3n,), is in mm. `covariance`, shape (3n, 3n), is the stated covariance of the error in mm².
    """

    error: Array
    covariance: Array

    @classmethod
    def of(cls, estimate: Estimate, truth: TrueField, axis_positions: Array) -> FieldError:
        """Return the error of the field that `estimate` predicts at n axis positions, shape (n, 3), in mm.

        The error is computed for the tool of the true machine `truth`.
        """
        offset = truth.tool_offset
        left = truth.deviation(axis_positions)
        # Exact, not linear: the second-order terms of the field would otherwise count as errors of the estimate.
        left -= exact_deviation(estimate.model, axis_positions, offset, estimate.parameters)
        columns = field_columns(estimate, axis_positions, offset).reshape(left.size, -1)
        covariance, expected = estimate.covariance, left.reshape(-1)
        misfit = estimate.misfit
        if misfit is not None:
            cross = misfit.cross_covariance
            covariance = np.block([[covariance, cross], [cross.T, misfit.covariance]])
            expected = expected - columns[:, estimate.model.size :] @ misfit.coefficients
        # With an orthonormal basis N of the rigid motions, 1 - N Nᵀ removes them from the error and from every column.
        motions = np.linalg.qr(_motions(axis_positions + offset))[0]
        columns = columns - motions @ (motions.T @ columns)
        whole = columns @ covariance @ columns.T
        # Misfit of short wavelength has the covariance v 1, which the projection turns into v (1 - N Nᵀ).
        whole += unresolved_variance(estimate) * (np.eye(len(columns)) - motions @ motions.T)
        return cls(expected - motions @ (motions.T @ expected), whole)

    def pointwise_levels(self) -> Array:
        """Return the level of one uncertainty interval for each component of the error at each point, shape (3n,).

        Each interval is symmetric about the expected value and ends exactly at the true value.
        """
        return two_sided_level(self.error / np.sqrt(np.diagonal(self.covariance)))

    def joint_level(self) -> float:
        """Return the level of the joint uncertainty region whose boundary passes through the true value.

        The region is an ellipsoid that covers all components of the error at all points.
        """
        return joint_level(self.error, self.covariance)


def two_sided_level(standardised: Array) -> Array:
    """Return, for each given value v, the probability that a standard normal variable lies between -|v| and |v|.

    `standardised`, shape (n,), contains the values; the result also has shape (n,).
    """
    return np.asarray(2.0 * ndtr(np.abs(standardised)) - 1.0)


def joint_level(error: Array, covariance: Array) -> float:
    """Return the level of the uncertainty ellipsoid whose surface passes through the point `error`, shape (n,).

    The ellipsoid is centred on zero, and `covariance`, shape (n, n), defines its shape. Directions in which the
    covariance is zero are ignored.
    """
    values, vectors = np.linalg.eigh(covariance)
    used = values > _MIN_VARIANCE * values[-1]
    # eᵀC⁻¹e, within the directions of C that are not zero, has a χ² distribution with as many degrees of freedom.
    square = float(np.sum((vectors.T @ error)[used] ** 2 / values[used]))
    return float(chdtr(float(used.sum()), square))


def parameter_levels(estimate: Estimate, truth: Array, share_of_prior: float) -> Array:
    """Return the level of one uncertainty interval for each parameter that the measurement has determined.

    A parameter counts as determined if its standard uncertainty is below `share_of_prior` times its stated prior
    standard deviation. Each interval is symmetric about the estimated value and ends exactly at the true value.
    `truth`, shape (p,), contains the true values of the p parameters. The levels are meaningful only for a machine that
    the model can represent.
    """
    sigma = estimate.standard_uncertainty
    known = sigma < share_of_prior * estimate.prior_scale
    return two_sided_level((truth - estimate.parameters)[known] / sigma[known])


@dataclass(frozen=True)
class VolumetricComparison:
    """Comparison of the true volumetric error of a machine, with or without compensation, with its expected value.

    `true_mm` is the true value, and `expected_mm` is the root of the expected mean square, both in mm. Both apply after
    the best-fitting rigid motion has been removed. `level` is the level of the equal-tailed uncertainty interval that
    ends exactly at the true value. As for the limits that an identification states (`volumetric_limits`), the upper
    ends of the intervals count the unresolved misfit, the lower ends do not; `level` is 0 for true values between the
    two medians.
    """

    true_mm: float
    expected_mm: float
    level: float


def volumetric_comparisons(
    estimate: Estimate, truth: TrueField, grid: Array
) -> tuple[VolumetricComparison, VolumetricComparison]:
    """Compare the true volumetric errors of the machine `truth` with their distributions according to `estimate`.

    The errors are the volumetric error without compensation (VE) and the volumetric compensated error (VCE), computed
    over the axis positions `grid`, shape (n, 3), in mm. Return the comparison of VE first and that of VCE second.
    """
    offset = truth.tool_offset
    true = truth.deviation(grid)
    left = true - exact_deviation(estimate.model, grid, offset, estimate.parameters)
    stated = aligned_distributions(estimate, grid, offset)
    found = []
    for field, upper, lower in ((true, stated.ve, stated.resolved_ve), (left, stated.vce, stated.resolved_vce)):
        rms_mm = volumetric_error(grid + offset, field).aligned_mm
        # An equal-tailed interval of level p ends at the quantiles (1 ± p)/2, so its upper end is the truth if
        # p = 2 P - 1, and its lower end if p = 1 - 2 P.
        above, below = (one.at_most(rms_mm**2) for one in (upper, lower))
        level = max(2.0 * above - 1.0, 1.0 - 2.0 * below, 0.0)
        found.append(VolumetricComparison(rms_mm, math.sqrt(upper.mean), level))
    return found[0], found[1]


def held_out_levels(
    estimate: Estimate, family: Family, seen: Observations, artefact: Artefact, options: Options
) -> Array:
    """Return the level of one uncertainty region for each of the K positions of the artefact in `seen`, shape (K,).

    The observations in `seen` are held out: `estimate` must not have used them. The pose of the artefact in each
    position is fitted and removed. The region is the joint uncertainty region of all balls of the position whose
    boundary passes through the measured values.
    """
    problem = build_problem(family, seen, artefact, options)
    left, local = problem.sides(estimate.z)
    residuals = left - rigid_poses(problem.layout, local, left).to_workpiece(problem.layout, local)
    return np.array([_held_out_level(estimate, problem, residuals, k) for k in range(problem.layout.positions)])


def _held_out_level(estimate: Estimate, problem: IdentificationProblem, residuals: Array, position: int) -> float:
    layout = problem.layout
    rows = np.flatnonzero(layout.index == position)
    design = problem.design[position, : len(rows)].reshape(3 * len(rows), -1)
    covariance = design @ estimate.z_covariance @ design.T
    for number, row in enumerate(rows):
        block = slice(3 * number, 3 * number + 3)
        # misfit of short wavelength, not resolved by the modes, is part of the estimated noise scale
        covariance[block, block] += estimate.scales.noise**2 * problem.observations.covariance[row]
    # project on the complement of the rigid motions, since the pose of the position is unknown
    motions = _motions(problem.observations.axis_positions[rows])
    free = np.linalg.qr(motions, mode="complete")[0][:, 6:]
    return joint_level(free.T @ residuals[rows].reshape(-1), free.T @ covariance @ free)


def _motions(points: Array) -> Array:
    """Return the six fields (3n, 6) of rigid motions at points (n, 3)."""
    # Scaled so that rotations displace the points about as far as translations: columns of equal size keep the QR
    # decomposition accurate.
    size_mm = max(float(np.ptp(points, axis=0).max()), 1.0)
    return rigid_fields(points, points.mean(axis=0), size_mm).reshape(-1, 6)
