"""The linearised equations of a set of ball centres, in unit-prior coordinates.

For row i of position k, with ball b and tool offset t,

    X_i + t + d(X_i; E) + misfit(X_i) = c_k + R_k (b_i(T) + δb_i + δs b_i) + noise

and every unknown but the poses is a vector z of unit-normal prior: parameters E, certificate errors δb, thermal strain
δs (CTE and thermometer), misfit modes. Rows are kept sorted by position.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from twin.arrays import Array
from twin.artefact import Artefact
from twin.error_model import ErrorModel
from twin.errors import DataError
from twin.identification.misfit import MisfitModes, misfit_modes
from twin.identification.options import Options
from twin.identification.poses import Layout, PoseArms, Poses, rigid_poses
from twin.identification.prior import ParameterPrior, symmetric_factor
from twin.machine_model import deviation_basis, exact_deviation
from twin.observations import Observations

Rows = np.ndarray[Any, np.dtype[np.int64]]
Sides = tuple[Array, Array]  # of the exact equations: workpiece points (n, 3) and artefact points (n, 3) mm


@dataclass(frozen=True, eq=False)
class Nuisance:
    """Unknowns of the artefact. `balls` (N, 3) mm; `certificate` (3N, m) factor of the certificate's covariance (m = 0
    for a perfect one); `strain_rows` (n, s) strain of each row per unit of each thermal unknown."""

    balls: Array
    certificate: Array
    strain_rows: Array

    def displacement(self, ball: np.ndarray[Any, Any], z_certificate: Array, z_strain: Array) -> Array:
        """Change (n, 3) of the artefact's points in its own frame."""
        change = np.zeros((len(ball), 3))
        if z_certificate.size:
            change += (self.certificate @ z_certificate).reshape(-1, 3)[ball]
        if z_strain.size:
            change += self.balls[ball] * (self.strain_rows @ z_strain)[:, None]
        return change


@dataclass(frozen=True, eq=False)
class Blocks:
    """Where each kind of unknown stands in z."""

    parameters: slice
    certificate: slice
    strain: slice
    misfit: slice

    @property
    def size(self) -> int:
        return int(self.misfit.stop)


@dataclass(frozen=True, eq=False)
class Problem:
    """Everything that does not change while the poses and z are improved. Rows (n) sorted by position.

    `local` (n, 3) mm: nominal artefact points at the rows' temperature and elevation; `design` (K, width, 3, P):
    derivative of the left side less the right side with respect to z, at `poses`, laid out by position; an empty place
    repeats another row of its position.
    """

    model: ErrorModel
    prior: ParameterPrior
    nuisance: Nuisance
    modes: MisfitModes | None
    blocks: Blocks
    observations: Observations
    layout: Layout
    local: Array
    arms: PoseArms
    poses: Poses
    design: Array

    def sides(self, z: Array) -> Sides:
        """Both sides at z; the artefact points are yet to be placed by a pose."""
        seen, blocks = self.observations, self.blocks
        left = tool_points(seen) + self.deviation(z)
        if self.modes is not None:
            left += self.change(_only(z, blocks.misfit))
        change = self.nuisance.displacement(seen.ball, z[blocks.certificate], z[blocks.strain])
        return left, self.local + change

    def sides_after(self, sides: Sides, step: Array) -> Sides:
        """Both sides after a step (P,) of z so small that its second order does not matter."""
        seen, blocks = self.observations, self.blocks
        left, local = sides
        moved = self.change(_only(step, blocks.parameters, blocks.misfit))
        change = self.nuisance.displacement(seen.ball, step[blocks.certificate], step[blocks.strain])
        return left + moved, local + change

    def change(self, z: Array) -> Array:
        """A z (n, 3) mm: the left side less the right side to first order."""
        # as one flat product: numpy multiplies a stack of small matrices one by one
        changes = self.design.reshape(-1, len(z)) @ z
        return self.layout.unpad(changes.reshape(self.design.shape[:3]))

    def deviation(self, z: Array) -> Array:
        """Exact model deviation (n, 3) mm at the rows."""
        seen, parameters = self.observations, self.prior.parameters(z[self.blocks.parameters])
        deviation = np.zeros_like(seen.axis_positions)
        if not parameters.any():
            return deviation
        for tool, rows in _rows_by_tool(seen.tool):
            offset = seen.tool_offsets[tool]
            deviation[rows] = exact_deviation(self.model, seen.axis_positions[rows], offset, parameters)
        return deviation

    def without(self, kept: np.ndarray[Any, Any]) -> Problem:
        """The problem with only the rows that `kept` (n,) bool selects."""
        layout = Layout.of(self.observations.position[kept])
        local = self.local[kept]
        seen = self.observations.where(kept)
        nuisance = replace(self.nuisance, strain_rows=self.nuisance.strain_rows[kept])
        used = np.unique(self.observations.position, return_inverse=True)[1][kept]
        alive = np.unique(used)
        poses = Poses(self.poses.rotation[alive], self.poses.translation[alive])
        return replace(
            self,
            observations=seen,
            layout=layout,
            local=local,
            arms=PoseArms.of(layout, local),
            nuisance=nuisance,
            poses=poses,
            design=_laid_out(layout, self.layout.unpad(self.design)[kept]),
        )


def build_problem(
    model: ErrorModel, observations: Observations, artefact: Artefact, prior: ParameterPrior, options: Options
) -> Problem:
    """Problem at the rigid poses of the measured points. DataError for a ball that the artefact does not have."""
    _check_balls(observations, artefact)
    layout = Layout.of(observations.position)
    seen = observations if _is_sorted(layout.order) else observations.where(layout.order)
    local = _artefact_points(artefact, seen)
    poses = rigid_poses(layout, local, tool_points(seen))
    nuisance = _nuisance(artefact, seen, options)
    modes = _modes(model, seen) if options.misfit_mm > 0.0 else None
    blocks = _blocks(model.size, nuisance, modes)
    design = _design(blocks, _Field(model, prior, modes, options.misfit_mm), nuisance, seen, layout, poses)
    return Problem(
        model=model,
        prior=prior,
        nuisance=nuisance,
        modes=modes,
        blocks=blocks,
        observations=seen,
        layout=layout,
        local=local,
        arms=PoseArms.of(layout, local),
        poses=poses,
        design=design.reshape(layout.positions, layout.width, 3, -1),
    )


def _only(z: Array, *blocks: slice) -> Array:
    """z (P,) with zero outside the blocks."""
    kept = np.zeros_like(z)
    for block in blocks:
        kept[block] = z[block]
    return kept


def tool_points(observations: Observations) -> Array:
    """Nominal tool points (n, 3) mm: axis positions + tool offset."""
    return np.asarray(observations.axis_positions + observations.tool_offsets[observations.tool])


def _check_balls(observations: Observations, artefact: Artefact) -> None:
    unknown = observations.ball >= artefact.count
    if unknown.any():
        row = int(np.argmax(unknown))
        raise DataError(
            f"ball {observations.ball[row]} is not on the artefact '{artefact.name}' with {artefact.count} balls",
            row=row,
            column="ball",
            hint="balls count from 0 in the artefact's list",
        )


def _is_sorted(order: np.ndarray[Any, Any]) -> bool:
    return bool((order[1:] > order[:-1]).all())


def _artefact_points(artefact: Artefact, seen: Observations) -> Array:
    """(n, 3) mm in the artefact frame at the temperature and elevation of each row."""
    strain = artefact.cte_per_k * (seen.temperature_c - artefact.reference_temperature_c)
    points = artefact.balls[seen.ball] * strain[:, None]
    elevations, group = np.unique(seen.elevation_rad, return_inverse=True)
    bent = np.stack([artefact.at(artefact.reference_temperature_c, float(angle)) for angle in elevations])
    return np.asarray(points + bent[group, seen.ball])


def _nuisance(artefact: Artefact, seen: Observations, options: Options) -> Nuisance:
    difference = seen.temperature_c - artefact.reference_temperature_c
    columns = []
    if artefact.cte_standard_uncertainty_per_k > 0.0 and difference.any():
        columns.append(artefact.cte_standard_uncertainty_per_k * difference)
    if options.temperature_standard_uncertainty_k > 0.0:
        strain = artefact.cte_per_k * options.temperature_standard_uncertainty_k
        columns.append(np.full(seen.size, strain))
    strain_rows = np.stack(columns, axis=1) if columns else np.zeros((seen.size, 0))
    return Nuisance(artefact.balls, _certificate_factor(artefact.covariance), strain_rows)


def _certificate_factor(covariance: Array) -> Array:
    diagonal = np.diagonal(covariance)
    if np.count_nonzero(covariance) == np.count_nonzero(diagonal):
        factor = np.diag(np.sqrt(diagonal))
    else:
        factor = symmetric_factor(covariance, "the covariance of the certificate")
    return factor[:, np.abs(factor).max(axis=0) > 0.0]


def _modes(model: ErrorModel, seen: Observations) -> MisfitModes:
    x, y, z = seen.tool_offsets[_main_tool(seen)].tolist()
    return misfit_modes(model, (x, y, z))


def _rows_by_tool(tools: np.ndarray[Any, Any]) -> list[tuple[int, slice | np.ndarray[Any, Any]]]:
    """Each tool in use with its rows; with a single one a slice, which copies nothing."""
    if (tools == tools[0]).all():
        return [(int(tools[0]), slice(None))]
    return [(int(tool), np.flatnonzero(tools == tool)) for tool in np.unique(tools)]


def _main_tool(seen: Observations) -> int:
    return int(np.bincount(seen.tool).argmax())


def _blocks(parameters: int, nuisance: Nuisance, modes: MisfitModes | None) -> Blocks:
    ends = np.cumsum(
        [parameters, nuisance.certificate.shape[1], nuisance.strain_rows.shape[1], modes.size if modes else 0]
    ).tolist()
    starts = [0, *ends[:-1]]
    return Blocks(*(slice(start, end) for start, end in zip(starts, ends, strict=True)))


@dataclass(frozen=True, eq=False)
class _Field:
    """What the deviation at a row is made of."""

    model: ErrorModel
    prior: ParameterPrior
    modes: MisfitModes | None
    misfit_mm: float


def _laid_out(layout: Layout, rows: Array) -> Array:
    """(K, width, ...) from sorted rows (n, ...); an empty place repeats another row of its position."""
    laid = rows if layout.full else rows.take(layout.source, axis=0)
    return laid.reshape(layout.positions, layout.width, *rows.shape[1:])


def _design(
    blocks: Blocks, field: _Field, nuisance: Nuisance, seen: Observations, layout: Layout, poses: Poses
) -> Array:
    """(K·width, 3, P)."""
    source = layout.source
    at, tool = seen.axis_positions[source], seen.tool[source]
    if blocks.size == blocks.parameters.stop and (tool == tool[0]).all():
        return deviation_basis(field.model, at, seen.tool_offsets[tool[0]], field.prior.scale)
    design = np.empty((len(source), 3, blocks.size))
    for number, rows in _rows_by_tool(tool):
        _fill_field(design, rows, blocks, field, at[rows], seen.tool_offsets[number])
    rotation = np.repeat(poses.rotation, layout.width, axis=0)
    _fill_artefact(design, blocks, nuisance, source, seen.ball[source], rotation)
    return design


def _fill_field(
    design: Array, rows: slice | np.ndarray[Any, Any], blocks: Blocks, field: _Field, at: Array, tool_offset: Array
) -> None:
    basis = deviation_basis(field.model, at, tool_offset)
    design[rows, :, blocks.parameters] = basis * field.prior.scale
    if field.modes is not None:
        at_hand = basis if (tool_offset == field.modes.tool_offset).all() else None
        design[rows, :, blocks.misfit] = field.misfit_mm * field.modes.at(at, at_hand)


def _fill_artefact(
    design: Array, blocks: Blocks, nuisance: Nuisance, source: Rows, ball: Rows, rotation: Array
) -> None:
    certificate = nuisance.certificate.reshape(len(nuisance.balls), 3, -1)
    design[:, :, blocks.certificate] = -(rotation @ certificate[ball])
    stretched = (rotation @ nuisance.balls[ball][:, :, None])[:, :, 0]
    design[:, :, blocks.strain] = -stretched[:, :, None] * nuisance.strain_rows[source][:, None, :]
