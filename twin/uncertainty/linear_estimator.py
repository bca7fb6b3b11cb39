"""Identification as a linear map from measurement errors to parameters; the linearisation is accurate to nanometres.

No measurements are needed. For the planned ball centres, the estimate is the product of a matrix K and the data if no
scales are estimated and no outliers are rejected. K = H⁻¹Aᵀ follows from the design matrix A and the posterior
precision H (the inverse of the posterior covariance). Both depend on the formulation of the equations (ball centres or
distances), the weights and the prior that are chosen.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from twin.arrays import Array
from twin.errors import DataError
from twin.identification.centres import CentreEquations
from twin.identification.distances import DistanceEquations
from twin.identification.normal import JointPrior, Posterior, PriorPrecision
from twin.identification.observability import null_space
from twin.identification.options import Options
from twin.identification.problem import IdentificationProblem
from twin.identification.scales import Scales
from twin.identification.unknowns import UnknownBlocks


@dataclass(frozen=True, eq=False)
class LinearEstimator:
    """Response of the p estimated parameters, in mm or rad, to each error of the measurement (influence).

    `certificate`, shape (p, m), is the response to one standard deviation of each of the m independent errors of the
    artefact's calibration certificate. `influences`, shape (p, x), is the response to each of x additional error
    fields. `noise`, shape (p, p), is the covariance that the stated touch noise causes in the parameters.
    """

    certificate: Array
    influences: Array
    noise: Array

    @classmethod
    def of(cls, problem: IdentificationProblem, options: Options, influences: Array) -> LinearEstimator:
        """Build the linear estimator of an identification problem.

        `influences`, shape (n, 3, x), contains x error fields in mm; each is added to the tool points of the n rows of
        `problem.observations`. Raises DataError if `options` contains an earlier estimate that is carried over as the
        prior, since the mean of such an estimate belongs to one particular machine.
        """
        if options.carried_over is not None:
            raise DataError(
                "the expected error is defined over a family of machines, so no earlier estimate can be carried over",
                hint="leave out the earlier estimate",
            )
        plain, blocks = options.weights == "unit", problem.blocks
        equations = _equations(_with_influences(problem, influences), options)
        # With unit weights only the machine parameters are unknowns; errors of the certificate then act as influences.
        used = blocks.parameters.stop if plain else blocks.size
        matrix = equations.matrix
        posterior = _posterior(matrix[:used, :used], blocks, options)
        # K f = H⁻¹ Aᵀ f: the equations hold Aᵀ f of certificate and influences as further columns
        response = posterior.solve(matrix[:used, blocks.certificate.start :])
        noise_gram = equations.noise_gram(used)[0] if plain else matrix[:used, :used]
        noise = posterior.solve(posterior.solve(noise_gram).T)  # H⁻¹ (Aᵀ C A) H⁻¹
        # The unknowns are in units of their prior standard deviation; `scale` converts them to mm and rad.
        own, scale = blocks.parameters, problem.unknowns.scale
        response = scale[:, None] * response[own]
        return cls(
            certificate=response[:, : blocks.certificate.stop - own.stop],
            influences=response[:, blocks.size - own.stop :],
            noise=problem.unknowns.physical_covariance(noise[own, own]),
        )


def _with_influences(problem: IdentificationProblem, influences: Array) -> IdentificationProblem:
    """Return the problem with the influences as additional design columns, so that its normal matrix contains their
    products with all other columns."""
    laid = problem.layout.pad(influences)
    blocks = problem.blocks
    # The extra columns are appended to the last block, so that the equations project the poses out of them, too.
    longer = replace(blocks, misfit=slice(blocks.misfit.start, blocks.size + influences.shape[2]))
    return replace(problem, design=np.concatenate((problem.design, laid), axis=3), blocks=longer)


def _equations(problem: IdentificationProblem, options: Options) -> CentreEquations | DistanceEquations:
    if options.formulation == "centres":
        return CentreEquations.build(problem, options.weights == "unit")
    return DistanceEquations.build(problem, options.weights == "unit", options.cut_off)


def _posterior(matrix: Array, blocks: UnknownBlocks, options: Options) -> Posterior:
    """Return the posterior. If the prior is off, the only prior holds at zero those directions that the measurements
    leave open."""
    if options.weights == "unit":
        blocks = UnknownBlocks.of(blocks.parameters.stop, 0, 0)
    if options.use_prior:
        return Posterior.of(matrix, PriorPrecision(blocks), Scales())
    open_ = null_space(matrix[blocks.parameters, blocks.parameters])
    return Posterior.of(matrix, PriorPrecision(blocks, JointPrior.at_zero(blocks, open_ @ open_.T)), Scales())
