"""Candidate positions of the artefact, each reduced to the information that its measurement gives about the unknowns
(errors of the machine and of the artefact) shared by all positions."""

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
from twin.identification.normal import PriorPrecision
from twin.identification.options import Options
from twin.identification.problem import IdentificationProblem, build_problem
from twin.identification.scales import Scales
from twin.machine.machine_population import Family
from twin.machine.volumetric import VolumetricRms

Indices = NDArray[np.intp]

SMALLEST_STEP_DEG = 2.5
"""Smallest step in degrees of a grid of orientations, which then has 10,512 of them."""

_MIN_INFORMATION = 1e-13  # of the largest information of a position: below it the prior is far more informative


@dataclass(frozen=True, eq=False)
class CandidatePositions:
    """N candidate positions of the artefact, sorted by station, azimuth, elevation and tool.

    `balls` (N,) is the number of measurable balls of each candidate. The vector z contains the P unknowns that all
    positions share. `factors` (N, r, P) contains one matrix W (r, P) for each candidate. The product WᵀW is the
    information about z that the candidate gives after its pose (the unknown rigid motion of the artefact) has been
    eliminated by projection. `precision` (P, P) is the precision of z without any position: that of the prior and of
    the planned readings of other instruments, whose whitened derivatives are `instruments` (m, P). `form` is the design
    criterion: the expected mean square of the error that remains after compensation, as a quadratic form of z.
    """

    positions: tuple[Position, ...]
    balls: Indices
    factors: Array
    precision: Array
    form: Criterion
    instruments: Array | None = None

    @property
    def count(self) -> int:
        return len(self.positions)

    @property
    def before(self) -> VolumetricRms:
        """Volumetric error expected from the prior alone, without any measurement."""
        if self.instruments is None:
            return self.vce([])
        alone: Array = np.asarray(np.linalg.inv(self.precision - self.instruments.T @ self.instruments))
        return self.form.expected(alone)

    def covariance(self, chosen: Sequence[int] | Indices) -> Array:
        """Return the posterior covariance (P, P) of the P unknowns z that all positions share, after the `chosen`
        candidates have been measured."""
        rows = self.factors[np.asarray(chosen, dtype=np.intp)].reshape(-1, self.factors.shape[2])
        inverse = np.linalg.inv(self.precision + rows.T @ rows)  # C = (D + Σ WᵀW)⁻¹
        return np.asarray(0.5 * (inverse + inverse.T))

    def vce(self, chosen: Sequence[int] | Indices) -> VolumetricRms:
        """Return the expected volumetric compensated error (VCE, the error that remains after compensation) if the
        `chosen` candidates have been measured.

        The result contains the VCE before and after removal of the best-fitting rigid motion. If no candidate is
        chosen, it is the VCE expected from the prior and the other instruments.
        """
        return self.form.expected(self.covariance(chosen))


def joined_candidates(parts: Sequence[CandidatePositions]) -> CandidatePositions:
    """Return the candidates of all `parts`, which have the same unknowns. The parts may contain the same positions with
    different balls."""
    rank = max(part.factors.shape[1] for part in parts)
    padded = [np.pad(part.factors, ((0, 0), (0, rank - part.factors.shape[1]), (0, 0))) for part in parts]
    return CandidatePositions(
        positions=tuple(position for part in parts for position in part.positions),
        balls=np.concatenate([part.balls for part in parts]),
        factors=np.concatenate(padded),
        precision=parts[0].precision,
        form=parts[0].form,
        instruments=parts[0].instruments,
    )


def orientation_grid(step_deg: float) -> tuple[tuple[float, float], ...]:
    """Return all pairs (azimuth, elevation) in degrees on a grid with the step `step_deg`. Azimuths cover the full
    circle; elevations run from -90° to 90°.

    No two pairs describe the same placement of the artefact. If a bar with balls (the artefact) is rotated by 180° in
    azimuth and the sign of its elevation is changed, it lies along the same line. Its balls are then on the other side
    of the mount, because the ball holders make the artefact asymmetric. Raise DataError if 90° is not a multiple of the
    step, or if the step is less than `SMALLEST_STEP_DEG`.
    """
    if 0.0 < step_deg < SMALLEST_STEP_DEG:
        raise DataError(
            f"the grid step {step_deg:g}° is less than {SMALLEST_STEP_DEG:g}°",
            hint="the number of orientations grows with the square of its inverse; choose for example 5, 10, 15 or 30",
        )
    steps = 90.0 / step_deg if step_deg > 0.0 else 0.0
    if not (steps >= 1.0 and abs(steps - round(steps)) < 1e-9):
        raise DataError(
            f"the grid step {step_deg:g}° does not divide 90°",
            hint="choose for example 10, 15, 22.5, 30 or 45",
        )
    count = round(steps)
    # -180° is left out, because it is the same as 180°
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
    """Return the candidates of a design: the measurable positions among `positions`. Positions with fewer than three
    measurable balls are omitted, and so are duplicates: of equal positions, the first is kept.

    `grid` (n, 3) in mm and `tool_offset` (3,) in mm define the error field to be minimised. The entries `formulation`
    and `estimate_scales` of `options` have no effect: each ball centre always gives three equations, and the noise, the
    prior and the misfit always have their stated standard deviations. Raise DataError if no position can be measured.
    """
    planned = procedure.plan(sorted(dict.fromkeys(positions), key=_order))
    problem = build_problem(family, planned.observations, procedure.artefact, options)
    precision, direct = PriorPrecision(problem.blocks, problem.known).matrix(Scales()), problem.direct
    return CandidatePositions(
        positions=planned.positions,
        balls=_balls(planned),
        factors=_factors(problem),
        precision=precision if direct is None else precision + direct.rows.T @ direct.rows,
        form=Criterion.build(problem.unknowns, grid, tool_offset),
        instruments=None if direct is None else direct.rows,
    )


def _order(position: Position) -> tuple[int, float, float, str]:
    return position.station, position.azimuth_deg, position.elevation_deg, position.tool or ""


def spread_balls(centres: Array, offered: Sequence[int], count: int) -> tuple[int, ...]:
    """Return `count` of the `offered` balls, in rising order. The two balls that are farthest apart come first, then
    always the ball that is farthest from all chosen ones (Gonzalez 1985).

    `centres` (N, 3) contains the centres of all N balls in mm. At least two balls must be asked for.
    """
    balls = np.array(offered)
    distances = np.linalg.norm(centres[balls][:, None] - centres[balls][None], axis=2)
    chosen = [int(index) for index in np.unravel_index(distances.argmax(), distances.shape)]
    while len(chosen) < count:
        chosen.append(int(distances[chosen].min(axis=0).argmax()))
    return tuple(sorted(balls[chosen].tolist()))


def _balls(planned: PlannedMeasurement) -> Indices:
    return np.bincount(planned.observations.position, minlength=len(planned.positions))


def _factors(problem: IdentificationProblem) -> Array:
    """Return the factors (N, r, P) of the N candidates.

    The equations of each position are transformed by a rotation that makes the equations used up by its pose zero. The
    zero equations are omitted.
    """
    size = problem.blocks.size
    # whitened equations, in each position projected on the complement of its six pose unknowns
    rows = CentreEquations.build(problem, unit_weights=False).projected(size)
    rows = problem.layout.pad(rows).reshape(problem.layout.positions, -1, size)
    # R Rᵀ = V Λ Vᵀ: the rows VᵀR carry the same information WᵀW = RᵀR, and those of λ = 0 are zero. One number of rows
    # for all positions keeps them in one array.
    strengths, directions = np.linalg.eigh(rows @ rows.transpose(0, 2, 1))
    used = (strengths > _MIN_INFORMATION * strengths.max()).any(axis=0)
    return np.asarray(directions[:, :, used].transpose(0, 2, 1) @ rows)
