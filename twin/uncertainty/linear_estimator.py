"""An identification as what it is to nanometres: a linear map from what the measurements are met by to the parameters.

Nothing is measured here: at the planned ball centres, without empirical Bayes and without outliers, the estimate is
K · data with K = H⁻¹Aᵀ of the formulation, weights and prior chosen.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from twin.arrays import Array
from twin.errors import DataError
from twin.identification.centres import CentreEquations
from twin.identification.distances import DistanceEquations
from twin.identification.normal import JointPrior, Posterior, PriorPrecision, Scales
from twin.identification.observability import null_space
from twin.identification.options import Options
from twin.identification.problem import IdentificationProblem
from twin.identification.unknowns import UnknownBlocks


@dataclass(frozen=True, eq=False)
class LinearEstimator:
    """What becomes of each influence in the estimated parameters, in mm or rad.

    `certificate` (p, m): per standard deviation of the certificate's errors; `influences` (p, x): per unit of each
    field asked for; `noise` (p, p): covariance from touch noise as stated.
    """

    certificate: Array
    influences: Array
    noise: Array

    @classmethod
    def of(cls, problem: IdentificationProblem, options: Options, influences: Array) -> LinearEstimator:
        """`influences` (n, 3, x) mm: fields added to the tool points, rows as in `problem.observations`.

        DataError for an estimate carried over: its mean has been measured, and belongs to one machine only.
        """
        if options.carried_over is not None:
            raise DataError(
                "the expected error is that over a family of machines, not of one whose estimate is carried over",
                hint="leave the earlier estimate out",
            )
        plain, blocks = options.weights == "unit", problem.blocks
        equations = _equations(_with(problem, influences), options)
        used = blocks.parameters.stop if plain else blocks.size
        matrix = equations.matrix
        posterior = _posterior(matrix[:used, :used], blocks, options)
        response = posterior.solve(matrix[:used, blocks.certificate.start :])
        noise_gram = equations.noise_gram(used)[0] if plain else matrix[:used, :used]
        noise = posterior.solve(posterior.solve(noise_gram).T)
        own, scale = blocks.parameters, problem.unknowns.scale
        response = scale[:, None] * response[own]
        return cls(
            certificate=response[:, : blocks.certificate.stop - own.stop],
            influences=response[:, blocks.size - own.stop :],
            noise=problem.unknowns.physical_covariance(noise[own, own]),
        )


def _with(problem: IdentificationProblem, influences: Array) -> IdentificationProblem:
    """The problem with the influences as further columns of its design, so that its equations make products of all."""
    laid = problem.layout.pad(influences)
    blocks = problem.blocks
    longer = replace(blocks, misfit=slice(blocks.misfit.start, blocks.size + influences.shape[2]))
    return replace(problem, design=np.concatenate((problem.design, laid), axis=3), blocks=longer)


def _equations(problem: IdentificationProblem, options: Options) -> CentreEquations | DistanceEquations:
    if options.formulation == "centres":
        return CentreEquations.build(problem, options.weights == "unit")
    return DistanceEquations.build(problem, options.weights == "unit")


def _posterior(matrix: Array, blocks: UnknownBlocks, options: Options) -> Posterior:
    """Prior off: only what the measurements leave open is held at zero."""
    if options.weights == "unit":
        blocks = UnknownBlocks.of(blocks.parameters.stop, 0, 0)
    if options.use_prior:
        return Posterior.of(matrix, PriorPrecision(blocks), Scales())
    open_ = null_space(matrix[blocks.parameters, blocks.parameters])
    return Posterior.of(matrix, PriorPrecision(blocks, JointPrior.at_zero(blocks, open_ @ open_.T)), Scales())
