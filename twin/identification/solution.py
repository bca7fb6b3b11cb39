"""Solution of the equations of an identification, in one formulation (ball centres or pairwise distances): estimation
of the scales, Gauss-Newton iterations on the exact model, and computation of the covariance."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from twin.arrays import Array
from twin.errors import SingularSet
from twin.identification.alternatives import Alternative, alternatives, mean_and_covariance
from twin.identification.centres import CentreEquations
from twin.identification.distances import DistanceEquations
from twin.identification.evidence import largest_log_evidence, log_evidence, most_likely_scales
from twin.identification.normal import JointPrior, NormalEquations, Posterior, PriorPrecision
from twin.identification.observability import null_space, observability, summary
from twin.identification.options import Formulation, Options
from twin.identification.poses import Poses
from twin.identification.problem import IdentificationProblem, Sides
from twin.identification.scales import Scales
from twin.identification.series_prior import SeriesPrior
from twin.identification.unknowns import UnknownBlocks

_MAX_ITERATIONS = 8
_CONVERGED = 1e-3  # of a prior standard deviation; each step is less than 1e-3 of the previous one

Equations = CentreEquations | DistanceEquations


@dataclass(frozen=True, eq=False)
class Solution:
    """Solution of an identification problem. It contains the P unknowns z (P,), the poses of the artefact, the left and
    the right side of the exact measurement equations at z, and the equations and the prior from which z was derived.
    `normal` are the normal equations whose solution is z at `scales`.

    `covariance` (P, P) is the covariance of the true minus the estimated z; it is valid for the parameters and the
    misfit. `scales_estimated` is True if `scales`, the factors on the standard deviations of noise, prior and misfit,
    were estimated from the data. `alternatives` contains solutions for other plausible scales; it is empty until the
    uncertainty of the scales has been included by `average_over_scales`.
    """

    equations: Equations
    normal: NormalEquations
    precision: PriorPrecision
    scales: Scales
    posterior: Posterior
    covariance: Array
    z: Array
    poses: Poses
    sides: Sides
    chi2: float
    degrees_of_freedom: float
    scales_estimated: bool = False
    alternatives: tuple[Alternative, ...] = ()


def solve(problem: IdentificationProblem, options: Options, formulation: Formulation) -> Solution:
    """Return the maximum a posteriori solution of an identification problem.

    Raise SingularSet if `options` switches the prior off and the measurements leave part of the error field
    undetermined.
    """
    if options.weights == "unit":
        return _solve_unit_weights(problem, options, formulation)
    equations = _equations(problem, formulation, unit_weights=False)
    precision = _precision(problem, equations.matrix, options)
    start, poses, _ = _normal(equations, np.zeros(problem.blocks.size), problem.poses)
    scales = options.start_scales
    if options.estimate_scales:
        scales = most_likely_scales(start, _of_balls(precision), scales)
    posterior = Posterior.of(equations.matrix, precision, scales)
    gain = _NormalSolver(posterior, scales.noise**2, precision.information_vector)
    z, normal, poses, sides = _iterate(equations, gain, start, poses)
    covariance = posterior.covariance
    # effective number of parameters: trace(C AᵀA) / σ²
    taken = float(np.vdot(covariance, equations.matrix)) / scales.noise**2
    degrees_of_freedom = max(equations.rows - taken, 1.0)
    chi2 = normal.misfit_square(z) / degrees_of_freedom
    free = options.estimate_scales
    return Solution(
        equations, normal, precision, scales, posterior, covariance, z, poses, sides, chi2, degrees_of_freedom, free
    )


def average_over_scales(solution: Solution) -> Solution:
    """Return the solution with z and its covariance averaged over all plausible scales, instead of z and its covariance
    at the likeliest scales."""
    if not solution.scales_estimated:
        return solution
    found = alternatives(solution.normal, solution.precision, solution.posterior, solution.scales)
    z, covariance = mean_and_covariance(found)
    normal, poses, sides = _normal(solution.equations, z, solution.poses)
    chi2 = normal.misfit_square(z) / solution.degrees_of_freedom
    return replace(solution, z=z, covariance=covariance, poses=poses, sides=sides, chi2=chi2, alternatives=found)


def log_evidence_and_scales(
    problem: IdentificationProblem, options: Options, start: Scales | None = None
) -> tuple[float, Scales]:
    """Return the log evidence (marginal likelihood) of the model in `problem` and the likeliest scales. Both are
    computed from ball centres weighted by their covariances, without the readings of other instruments.

    The estimation of the scales starts with `start` if it is given. Terms of the log evidence that depend only on the
    measured rows are omitted.
    """
    equations = _equations(problem, "centres", unit_weights=False)
    normal, _, _ = _normal(equations, np.zeros(problem.blocks.size), problem.poses)
    precision = _of_balls(_precision(problem, equations.matrix, options))
    scales = start or options.start_scales
    if options.estimate_scales:
        return largest_log_evidence(normal, precision, scales)
    return log_evidence(normal, precision, scales), scales


def normal_equations(problem: IdentificationProblem) -> NormalEquations:
    """Return the normal equations of the ball centres of `problem`, weighted by their covariances and linearised at
    z = 0. Those of several positions with the same unknowns are the sum of those of each position."""
    equations = _equations(problem, "centres", unit_weights=False)
    return _normal(equations, np.zeros(problem.blocks.size), problem.poses)[0]


def free_precision(problem: IdentificationProblem) -> PriorPrecision:
    """Return the prior precision of the unknowns of `problem` as it is used if the scales are estimated."""
    unknowns = problem.unknowns
    series = SeriesPrior.of(unknowns.model, unknowns.scale)
    return PriorPrecision(problem.blocks, problem.known, series, direct=problem.direct)


def _equations(
    problem: IdentificationProblem, formulation: Formulation, unit_weights: bool, cut_off: float | None = None
) -> Equations:
    if formulation == "centres":
        return CentreEquations.build(problem, unit_weights)
    return DistanceEquations.build(problem, unit_weights, cut_off)


def _normal(equations: Equations, z: Array, poses: Poses) -> tuple[NormalEquations, Poses, Sides]:
    """Return the normal equations with the exact residuals at z, the best-fitting poses, and both sides of the exact
    equations at z."""
    sides = equations.problem.sides(z)
    right, square, poses = equations.right_side(z, sides, poses)
    return NormalEquations(equations.matrix, right, square, equations.rows), poses, sides


@dataclass(frozen=True, eq=False)
class _NormalSolver:
    """Map from the right side of the normal equations to their solution z."""

    posterior: Posterior
    variance: float
    information_vector: Array

    def of(self, normal: NormalEquations) -> Array:
        return self.posterior.solve(normal.right / self.variance + self.information_vector)


def _iterate(
    equations: Equations, gain: _NormalSolver, normal: NormalEquations, poses: Poses
) -> tuple[Array, NormalEquations, Poses, Sides]:
    """Solve the equations by Gauss-Newton iterations with exact residuals and a single factorisation. Two steps
    suffice, because the field is linear to nanometres.

    The sides at the last z are computed from the sides of the previous step with the design matrix. This is accurate
    because a step below `_CONVERGED` has a second-order effect below 1e-9 mm.
    """
    z = gain.of(normal)
    for _ in range(_MAX_ITERATIONS):
        normal, poses, sides = _normal(equations, z, poses)
        previous, z = z, gain.of(normal)
        if float(np.abs(z - previous).max()) < _CONVERGED:
            return z, normal, poses, equations.problem.sides_after(sides, z - previous)
    raise SingularSet(
        "the identification does not converge",
        hint="check units, ball numbers and tool offset: the errors are far larger than those of a machine",
    )


def _of_balls(precision: PriorPrecision) -> PriorPrecision:
    """Return the prior precision without the readings of other instruments, which say nothing about scales and order
    (`twin.identification.alternatives`)."""
    return replace(precision, direct=None)


def _precision(problem: IdentificationProblem, matrix: Array, options: Options) -> PriorPrecision:
    """Return the prior precision. If the prior is off, only the directions that the measurements leave open are held at
    zero."""
    if options.use_prior:
        unknowns = problem.unknowns
        free = options.estimate_scales and options.carried_over is None
        series = SeriesPrior.of(unknowns.model, unknowns.scale) if free else None
        return PriorPrecision(problem.blocks, problem.known, series, direct=problem.direct)
    block = problem.blocks.parameters
    if options.formulation == "centres" and options.weights == "full":
        _check_field_determined(problem, matrix[block, block])
    return PriorPrecision(problem.blocks, JointPrior.at_zero(problem.blocks, _null_projector(matrix[block, block])))


def _check_field_determined(problem: IdentificationProblem, information: Array) -> None:
    tools = problem.observations.used_tool_offsets
    seen = observability(problem.unknowns.model, information, problem.unknowns.scale, tools)
    unseen = [direction for direction in seen.null_directions if direction.changes_field]
    if unseen:
        raise SingularSet(
            f"the set leaves {len(unseen)} direction(s) of the error field open: {'; '.join(summary(unseen))}",
            hint="switch the prior on or add positions",
        )


def _solve_unit_weights(problem: IdentificationProblem, options: Options, formulation: Formulation) -> Solution:
    """Solve with the published weighting: all equations have equal weight, and there are no nuisance unknowns.

    The covariance is computed for this estimator under the full model (sandwich covariance). The stated accuracy is
    therefore still correct.
    """
    equations = _equations(problem, formulation, unit_weights=True, cut_off=options.cut_off)
    block, size = problem.blocks.parameters, problem.blocks.size
    information = equations.matrix[block, block]
    alone = UnknownBlocks.of(block.stop, 0, 0)
    precision = PriorPrecision(
        alone, None if options.use_prior else JointPrior.at_zero(alone, _null_projector(information))
    )
    posterior = Posterior.of(information, precision, Scales())
    z, poses = np.zeros(size), problem.poses
    for _ in range(_MAX_ITERATIONS):
        normal, poses, _ = _normal(equations, z, poses)
        previous = z[block]
        z = np.zeros(size)
        z[block] = posterior.solve(normal.right[block])
        if float(np.abs(z[block] - previous).max()) < _CONVERGED:
            break
    covariance, expected = _sandwich(equations, posterior, problem)
    taken = float((posterior.covariance * information).sum())
    degrees_of_freedom = max(equations.rows - taken, 1.0)
    chi2 = normal.misfit_square(z) / expected
    sides = problem.sides(z)
    return Solution(
        equations, normal, precision, Scales(), posterior, covariance, z, poses, sides, chi2, degrees_of_freedom
    )


def _null_projector(information: Array) -> Array:
    open_ = null_space(information)
    return np.asarray(open_ @ open_.T)


def _sandwich(equations: Equations, posterior: Posterior, problem: IdentificationProblem) -> tuple[Array, float]:
    """Return the covariance (P, P) of the true minus the estimated unknowns, and the expected sum of squared residuals.

    The estimate of the parameters is H⁻¹Aᵀy, where H is the posterior precision, A is the design matrix of the
    parameters, and y is the right side of the equations. The estimate omits the nuisance unknowns, but both results
    include their effect. The results assume that the true parameters and nuisance unknowns follow their priors and that
    the noise has its stated covariance.
    """
    blocks = problem.blocks
    block, rest = blocks.parameters, slice(blocks.parameters.stop, blocks.size)
    own, shared = equations.matrix[block, block], equations.matrix[block, rest]
    gram, total = equations.noise_gram(block.stop)
    others, noise = posterior.solve(shared), posterior.solve(gram)
    # error of the parameters: (1 - H⁻¹N) z - H⁻¹Aᵀ(A₂ z₂ + noise), with z₂ the nuisance unknowns
    kept = np.eye(block.stop) - posterior.solve(own)
    error = kept @ kept.T + posterior.solve(noise.T) + others @ others.T
    full = np.eye(blocks.size)
    full[block, block] = error
    full[block, rest] = -others
    full[rest, block] = -others.T
    expected = float((own * error).sum()) + float(np.trace(equations.matrix[rest, rest])) + total
    expected -= 2.0 * (float((shared * others).sum()) + float(np.trace(noise)))
    if isinstance(equations, DistanceEquations):
        expected += equations.omitted  # a parameter of unit variance along each direction below the cut-off
    return full, max(expected, 1e-300)
