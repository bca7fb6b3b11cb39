"""Test if a machine is still as expected; if it is not, identify the error that has jumped (changed suddenly).

The prior knowledge of the P unknowns z of the identification is a Gaussian distribution with mean m and covariance C.
The measured ball centres give the equations y = A z + noise with the design matrix A and the right side y. The
equations are whitened, which means that their noise is uncorrelated and has the same standard deviation σ everywhere.
The unknown poses of the artefact have been eliminated. The innovation y - A m, the difference between measurement and
expectation, then has the covariance S = σ² I + A C Aᵀ, where I is the identity matrix.

A score test examines the hypothesis that the coefficients of one error have also changed (module
`twin.identification.jump`). It needs the score and the information

    s = AᵀS⁻¹(y - A m), F = AᵀS⁻¹A,

of shapes (P,) and (P, P). F is computed from the prior and the design matrix as

    F = C⁻¹ - C⁻¹(C⁻¹ + AᵀA/σ²)⁻¹C⁻¹.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from twin.arrays import Array
from twin.artefact.artefact import Artefact
from twin.artefact.observations import Observations
from twin.identification.centres import CentreEquations
from twin.identification.jump import ERRORS, SuspectedJump, coefficients_of, suspected_jump
from twin.identification.normal import NormalEquations, PriorPrecision
from twin.identification.options import Options
from twin.identification.prior_from_estimate import CarriedOverPrior
from twin.identification.problem import IdentificationProblem, build_problem
from twin.identification.unknowns import Unknowns
from twin.machine.machine_population import Family

JUMP_SIZES = (1.0, 3.0, 10.0)
"""Standard deviations of an assumed jump, in those of the family, over which the odds of its error are averaged.

Few positions do not tell a jump of one error from that of another, if each of them may be as large as it has to be.
With one size alone, an error that has to jump by several standard deviations would be ruled out.
"""

_SHARE = 0.95  # probability of all named errors together
_EXACT_STEPS = 2  # as in an identification: the first step leaves second-order terms of a pose a few mm off


@dataclass(frozen=True)
class PossibleJump:
    """Error whose sudden change would explain the measurements, and its probability if one error has jumped."""

    jump: SuspectedJump
    probability: float

    @property
    def text(self) -> str:
        """The jump in words, with its probability."""
        return f"{self.jump.text} ({100.0 * self.probability:.0f} %)"


@dataclass(frozen=True, eq=False)
class Innovation:
    """Comparison of measured ball centres with prior knowledge of the P unknowns z of the identification.

    The equations of the ball centres are y = A z + noise with the design matrix A and the right side y. They are
    whitened, which means that their noise is uncorrelated and has the same standard deviation σ everywhere. The unknown
    poses of the artefact have been eliminated. Before the measurement, z has the `mean` m, shape (P,), and the
    `covariance` C, shape (P, P). The innovation y - A m, the difference between measurement and expectation, has the
    covariance S = σ² I + A C Aᵀ, where I is the identity matrix.

    `score`, shape (P,), is AᵀS⁻¹(y - A m), and `information`, shape (P, P), is AᵀS⁻¹A. `chi2` is (y - A m)ᵀS⁻¹(y - A
    m), and `rows` is the number of equations that contribute to `chi2`.
    """

    unknowns: Unknowns
    mean: Array
    covariance: Array
    score: Array
    information: Array
    chi2: float
    rows: int

    @property
    def chi2_normalised(self) -> float:
        return self.chi2 / self.rows

    @cached_property
    def posterior_mean(self) -> Array:
        """Mean, shape (P,), of the unknowns z given the prior knowledge and the measured ball centres."""
        return np.asarray(self.mean + self.covariance @ self.score)

    @cached_property
    def posterior_covariance(self) -> Array:
        """Covariance, shape (P, P), of the unknowns z given the prior knowledge and the measured ball centres."""
        after = self.covariance - self.covariance @ self.information @ self.covariance
        return np.asarray(0.5 * (after + after.T))

    def suspects(self, jump: float = 1.0) -> tuple[SuspectedJump, ...]:
        """Return the suspected jump of each error of the error model, the most likely jump first.

        `jump` is the standard deviation of the assumed jump of a coefficient, divided by the standard deviation of the
        coefficient in the family of machines.
        """
        found = [self._suspect(error, jump) for error in ERRORS if coefficients_of(self.unknowns, error).size]
        return tuple(sorted(found, key=lambda one: -one.evidence))

    def possible_jumps(self) -> tuple[PossibleJump, ...]:
        """Return the errors of which one may have jumped, the likeliest first, until they have a probability of 95 %
        together.

        All errors and all of `JUMP_SIZES` are equally likely beforehand. The size of each jump is the expected one for
        the likeliest of these.
        """
        by_size = [{one.error: one for one in self.suspects(size)} for size in JUMP_SIZES]
        best = max(one.evidence for found in by_size for one in found.values())
        odds = {error: sum(math.exp(found[error].evidence - best) for found in by_size) for error in by_size[0]}
        whole, named = sum(odds.values()), list[PossibleJump]()
        for error in sorted(odds, key=lambda error: -odds[error]):
            if sum(one.probability for one in named) >= _SHARE:
                break
            jump = max((found[error] for found in by_size), key=lambda one: one.evidence)
            named.append(PossibleJump(jump, odds[error] / whole))
        return tuple(named)

    def find_jumps(self, evidence: float, most: int = 3, jump: float = 1.0) -> tuple[SuspectedJump, ...]:
        """Search for the errors that have jumped, and return them in the order in which they are found.

        Each step of the search takes the error with the largest evidence, which is the natural logarithm of the
        likelihood ratio of a jump against no jump. Errors found in earlier steps are still assumed to have jumped by an
        unknown amount. The search ends when the largest evidence is smaller than `evidence`, or when `most` errors have
        been found. `jump` is the standard deviation of the assumed jump of a coefficient, divided by the standard
        deviation of the coefficient in the family of machines.
        """
        left, named = self, []
        for _ in range(most):
            best = left.suspects(jump)[0]
            if best.evidence < evidence:
                break
            named.append(best)
            left = left._without(best.error, jump)
        return tuple(named)

    def _suspect(self, error: str, jump: float) -> SuspectedJump:
        columns = coefficients_of(self.unknowns, error)
        inner = self.information[np.ix_(columns, columns)]
        return suspected_jump(self.unknowns, error, self.score[columns], inner, jump)

    def _without(self, error: str, jump: float) -> Innovation:
        """Return the innovation after this error has been allowed to jump: S + A J Λ JᵀAᵀ replaces S.

        J selects the coefficients of the error in z, and Λ is their variance for a jump of size `jump`.
        """
        columns = coefficients_of(self.unknowns, error)
        through = self.information[:, columns]
        free = cho_factor(np.eye(len(columns)) / jump**2 + self.information[np.ix_(columns, columns)], lower=True)
        taken = cho_solve(free, self.score[columns])
        return replace(
            self,
            score=self.score - through @ taken,
            information=self.information - through @ cho_solve(free, through.T),
            chi2=self.chi2 - float(self.score[columns] @ taken),
        )


def innovation(
    family: Family,
    observations: Observations,
    artefact: Artefact,
    known: CarriedOverPrior,
    options: Options | None = None,
) -> Innovation:
    """Compare measured ball centres (`observations`) with the prior knowledge `known`, which was carried over from an
    earlier estimate.

    The covariance in `known` must already include the changes that are expected since this estimate (the process
    noise). The scale of the touch noise is taken from `known`. `options` are those of the identification of the same
    balls, but here no ball is rejected and no scale is estimated. Raises DataError if the model, the artefact or the
    balls of the arguments do not match.
    """
    options = replace(options or Options(), carried_over=known, outliers="none", estimate_scales=False)
    problem = build_problem(family, observations, artefact, options)
    precision = PriorPrecision(problem.blocks, problem.known)
    before = precision.matrix(known.scales)
    # before = C⁻¹, after = C⁻¹ + AᵀA/σ²: s = C⁻¹ after⁻¹ Aᵀr/σ², F = C⁻¹ - C⁻¹ after⁻¹ C⁻¹
    factor = cho_factor(before, lower=True)
    mean, covariance = cho_solve(factor, precision.information_vector), cho_solve(factor, np.eye(len(before)))
    normal = _normal(problem, mean)
    variance = known.scales.noise**2
    right = (normal.right - normal.matrix @ mean) / variance
    after = cho_factor(before + normal.matrix / variance, lower=True)
    back = cho_solve(after, before)
    information = before - before @ back
    return Innovation(
        unknowns=problem.unknowns,
        mean=mean,
        covariance=0.5 * (covariance + covariance.T),
        score=before @ cho_solve(after, right),
        information=0.5 * (information + information.T),
        chi2=normal.misfit_square(mean) / variance - float(right @ cho_solve(after, right)),
        rows=normal.rows,
    )


def _normal(problem: IdentificationProblem, mean: Array) -> NormalEquations:
    """Return the normal equations whose right side holds the exact residuals at z = `mean`."""
    equations = CentreEquations.build(problem, unit_weights=False)
    sides, poses = problem.sides(mean), problem.poses
    for _ in range(_EXACT_STEPS):
        right, square, poses = equations.right_side(mean, sides, poses)
    return NormalEquations(equations.matrix, right, square, equations.rows)
