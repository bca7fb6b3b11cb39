"""Valuation of a set of artefact positions by one number, the expected reduction of the volumetric error of the
machine."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from twin.arrays import Array
from twin.artefact.artefact import Artefact
from twin.artefact.observations import Observations
from twin.design.criterion import Criterion
from twin.identification.centres import CentreEquations
from twin.identification.normal import Posterior, PriorPrecision
from twin.identification.options import Options
from twin.identification.problem import IdentificationProblem, build_problem
from twin.identification.scales import Scales
from twin.machine.machine_population import Family
from twin.machine.volumetric import VolumetricRms


@dataclass(frozen=True)
class Valuation:
    """Expected volumetric error of machines of the prior population, before and after compensation with
    the measurements of a position set.

    `before` is the expected error without compensation, including the misfit. `after` is the expected volumetric
    compensated error (VCE).
    """

    before: VolumetricRms
    after: VolumetricRms

    @property
    def percent(self) -> float:
        """Expected reduction of the volumetric error by compensation, in percent. Both errors are taken after the
        best-fitting rigid motion has been removed.

        The result is 0 for a position set without information, 100 if no error remains, and negative if compensation
        makes machines worse.
        """
        return 100.0 * (1.0 - self.after.aligned_mm / self.before.aligned_mm)


def valuation(
    family: Family,
    artefact: Artefact,
    observations: Observations,
    options: Options,
    grid: ArrayLike,
    tool_offset: ArrayLike,
) -> Valuation:
    """Return the valuation of a position set from its planned ball centres `observations`. The identification is
    assumed to use the family as prior and to weight the ball centres by their covariances, with all standard deviations
    as stated. The error is evaluated over `grid` for a tool with the offset `tool_offset`, both in mm."""
    problem = build_problem(family, observations, artefact, options)
    form = Criterion.build(problem.unknowns, grid, tool_offset)
    return Valuation(*(form.expected(covariance) for covariance in _covariances(problem)))


def _covariances(problem: IdentificationProblem) -> tuple[Array, Array]:
    precision = PriorPrecision(problem.blocks, problem.known, direct=problem.direct)
    matrix = CentreEquations.build(problem, unit_weights=False).matrix
    # the posterior of no measurement is the prior
    nothing = np.zeros_like(matrix)
    return (
        Posterior.of(nothing, replace(precision, direct=None), Scales()).covariance,
        Posterior.of(matrix, precision, Scales()).covariance,
    )
