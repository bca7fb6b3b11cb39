"""Positions that could be measured, each reduced to what it tells of the shared unknowns."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import ArrayLike, NDArray

from twin.arrays import Array
from twin.artefact.position_set import Position
from twin.design.criterion import Criterion
from twin.design.procedure import PlannedMeasurement, Procedure
from twin.errors import DataError
from twin.identification.centres import CentreEquations
from twin.identification.normal import PriorPrecision, Scales
from twin.identification.options import Options
from twin.identification.problem import IdentificationProblem, build_problem
from twin.machine.machine_population import Family
from twin.machine.volumetric import VolumetricRms

Indices = NDArray[np.intp]

_SEEN = 1e-13  # of the largest information of a position: what is below it the prior knows better by far


@dataclass(frozen=True, eq=False)
class CandidatePositions:
    """N positions in the order of station, azimuth, elevation, tool.

    `balls` (N,) within reach of each; `factors` (N, r, P) W of each, WᵀW its information about the shared unknowns z
    with its pose projected out (rows of zero where it tells less than others); `precision` (P, P) of z before anything
    is measured; `form` the criterion.
    """

    positions: tuple[Position, ...]
    balls: Indices
    factors: Array
    precision: Array
    form: Criterion

    @property
    def count(self) -> int:
        return len(self.positions)

    def covariance(self, chosen: Sequence[int] | Indices) -> Array:
        """(P, P) of z once the `chosen` ones have been measured."""
        rows = self.factors[np.asarray(chosen, dtype=np.intp)].reshape(-1, self.factors.shape[2])
        inverse = np.linalg.inv(self.precision + rows.T @ rows)
        return np.asarray(0.5 * (inverse + inverse.T))

    def vce(self, chosen: Sequence[int] | Indices) -> VolumetricRms:
        """Expected volumetric compensated error once the `chosen` ones have been measured; of none: what there is."""
        return self.form.expected(self.covariance(chosen))


def orientation_grid(step_deg: float) -> tuple[tuple[float, float], ...]:
    """Azimuth and elevation in degrees, all around and from nadir to zenith. DataError for a step not dividing 90°.

    Holders make the artefact lopsided, so no two of them are the same: turned by half a turn and mirrored in elevation,
    the bar lies along the same line with its balls on the other side of the mount.
    """
    steps = 90.0 / step_deg if step_deg > 0.0 else 0.0
    if not (steps >= 1.0 and abs(steps - round(steps)) < 1e-9):
        raise DataError(
            f"a grid of {step_deg:g}° does not divide 90°",
            hint="choose for instance 10, 15, 22.5, 30 or 45",
            key="grid",
        )
    count = round(steps)
    azimuths = [index * step_deg for index in range(1 - 2 * count, 2 * count + 1)]
    elevations = [index * step_deg for index in range(-count, count + 1)]
    return tuple(product(azimuths, elevations))


def build_candidates(
    procedure: Procedure,
    positions: Sequence[Position],
    family: Family,
    options: Options,
    grid: ArrayLike,
    tool_offset: ArrayLike,
) -> CandidatePositions:
    """What each of `positions` tells; those with fewer than three balls within reach are left out, doubles count once.

    `grid` (n, 3) mm and `tool_offset` (3,): where and for which tool the error field is to become small. Formulation
    and scales of `options` do not matter: ball centres, and noise, prior and misfit as stated. DataError where nothing
    is within reach.
    """
    planned = procedure.plan(sorted(set(positions), key=_order))
    problem = build_problem(family, planned.observations, procedure.artefact, options)
    return CandidatePositions(
        positions=planned.positions,
        balls=_balls(planned),
        factors=_factors(problem),
        precision=PriorPrecision(problem.blocks, problem.known).matrix(Scales()),
        form=Criterion.build(problem.unknowns, grid, tool_offset),
    )


def _order(position: Position) -> tuple[int, float, float, str]:
    return position.station, position.azimuth_deg, position.elevation_deg, position.tool or ""


def _balls(planned: PlannedMeasurement) -> Indices:
    return np.bincount(planned.observations.position, minlength=len(planned.positions))


def _factors(problem: IdentificationProblem) -> Array:
    """(N, r, P): the rows of each position turned so that the six that its pose has taken fall away."""
    size = problem.blocks.size
    rows = CentreEquations.build(problem, unit_weights=False).projected(size)
    rows = problem.layout.pad(rows).reshape(problem.layout.positions, -1, size)
    strengths, directions = np.linalg.eigh(rows @ rows.transpose(0, 2, 1))
    used = (strengths > _SEEN * strengths.max()).any(axis=0)
    return np.asarray(directions[:, :, used].transpose(0, 2, 1) @ rows)
