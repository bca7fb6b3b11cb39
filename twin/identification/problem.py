"""Linearised equations of a set of ball centres, in unit-prior coordinates (each unknown in units of its prior standard
deviation).

Each row i is the measurement of one ball in a position k with the tool offset t. The equation of the row is

    X_i + t + d(X_i; E) + misfit(X_i) + drift(X_i, i) + shift(i) = c_k + R_k (b_i(T) + δb_i + δs b_i) + noise

where X_i is the axis position, d the deviation of the model, and b_i(T) the calibrated ball centre at temperature T.
The pose of the position consists of the translation c_k and the rotation R_k. Every unknown except the poses is part of
a vector z with a unit-normal prior. The vector contains the parameters E, the certificate errors δb, the thermal strain
δs (uncertainty of the coefficient of thermal expansion and of the thermometer), the error of the stated sag, the modes
of the misfit, the drift of the machine and, where measurements show them, shifts of the balls (lost motion of an axis).
Rows are sorted by position.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from twin.arrays import Array
from twin.artefact.artefact import Artefact
from twin.artefact.mount_geometry import MountGeometry
from twin.artefact.observations import Observations
from twin.artefact.position_set import mount_pose
from twin.errors import DataError
from twin.identification.instruments.rows import direct_information
from twin.identification.normal import DirectInformation, JointPrior
from twin.identification.options import Options
from twin.identification.poses import PoseArms, Poses, RowLayout, rigid_poses
from twin.identification.prior import unknowns_of
from twin.identification.prior_from_estimate import joint_prior_for
from twin.identification.straight_lines import StraightLines
from twin.identification.unknowns import ArtefactErrors, BallShift, UnknownBlocks, Unknowns
from twin.machine.forward_model import deviation_basis, exact_deviation
from twin.machine.machine_population import Family

Rows = np.ndarray[Any, np.dtype[np.int64]]
Sides = tuple[Array, Array]  # sides of the exact equations: workpiece points (n, 3) and artefact points (n, 3) in mm


@dataclass(frozen=True, eq=False)
class Nuisance:
    """Errors of the artefact, and their effect on the n rows (measured ball centres).

    `strain_rows` (n, s) is the strain of the artefact in each row per unit of each of the s thermal unknowns.
    `warmer_k` (n,) is the temperature of the artefact in each row minus the reference temperature, in K.
    """

    errors: ArtefactErrors
    strain_rows: Array
    warmer_k: Array

    def displacement(self, ball: np.ndarray[Any, Any], z_certificate: Array, z_strain: Array) -> Array:
        """Return the displacement (n, 3) in mm of the balls with the numbers `ball` (n,), in the artefact's own frame.
        The displacement follows from the unknown errors of the certificate `z_certificate` and the thermal unknowns
        `z_strain`."""
        change = np.zeros((len(ball), 3))
        if z_certificate.size:
            change += (self.errors.certificate @ z_certificate).reshape(-1, 3)[ball]
        if z_strain.size:
            change += self.errors.balls[ball] * (self.strain_rows @ z_strain)[:, None]
        return change

    def with_rows(self, accepted: np.ndarray[Any, Any]) -> Nuisance:
        """Return the effect on the rows that the mask `accepted` (n,) marks."""
        return replace(self, strain_rows=self.strain_rows[accepted], warmer_k=self.warmer_k[accepted])


@dataclass(frozen=True, eq=False)
class IdentificationProblem:
    """Quantities that stay fixed while the poses of the artefact and the P unknowns z are refined. The n rows (measured
    ball centres) are sorted by artefact position.

    `local` (n, 3) in mm contains the nominal artefact points at the rows' temperature. `sag` (n, 3) in mm is their
    displacement by gravity in the workpiece frame, or None for a stiff artefact. `bending` (n, 3) is the displacement
    by gravity for a sag of 1, or None for an artefact that is not a single bar, and `sag_size_mm` is the standard
    deviation of an unstated sag. `design` (K,
    width, 3, P) is the derivative of left minus right side with respect to z, at `poses`, laid out by position. An
    empty slot repeats another row of its position. `direct` are the readings of other instruments, or None without any.
    """

    unknowns: Unknowns
    known: JointPrior | None
    nuisance: Nuisance
    blocks: UnknownBlocks
    observations: Observations
    layout: RowLayout
    local: Array
    sag: Array | None
    bending: Array | None
    sag_size_mm: float
    arms: PoseArms
    poses: Poses
    design: Array
    direct: DirectInformation | None = None

    @property
    def touched(self) -> Array:
        """Nominal tool points (n, 3) in mm, less the sag of the artefact."""
        points = tool_points(self.observations)
        return points if self.sag is None else points - self.sag

    def sides(self, z: Array) -> Sides:
        """Return the left and the right side of the exact measurement equations at the unknowns z, each (n, 3) in mm
        for n measured balls. The left side contains the actual tool points in the workpiece frame. The right side
        contains the ball centres in the artefact's frame, because the poses of the artefact are applied later."""
        seen, blocks = self.observations, self.blocks
        left = self.touched + self.deviation(z)
        if blocks.size > blocks.sag.start:
            left += self.change(_only(z, blocks.sag, blocks.misfit, blocks.drift, blocks.shifts))
        change = self.nuisance.displacement(seen.ball, z[blocks.certificate], z[blocks.strain])
        return left, self.local + change

    def sides_after(self, sides: Sides, step: Array) -> Sides:
        """Return the left side (actual tool points) and the right side (ball centres) of the measurement equations
        after the unknowns z have changed by a small `step` (P,).

        `sides` contains both sides before the step. The change is computed to first order with the design matrix; the
        step must be small enough for its second-order effect to be negligible.
        """
        seen, blocks = self.observations, self.blocks
        left, local = sides
        moved = self.change(_only(step, blocks.parameters, blocks.sag, blocks.misfit, blocks.drift, blocks.shifts))
        change = self.nuisance.displacement(seen.ball, step[blocks.certificate], step[blocks.strain])
        return left + moved, local + change

    def change(self, z: Array) -> Array:
        """Return the product A z (n, 3) in mm of the design matrix A and the unknowns z. To first order, A z is the
        change, caused by z, of the left side (actual tool points) minus the right side (ball centres) of the n
        measurement equations."""
        # one flat product, since numpy multiplies stacked small matrices one at a time
        changes = self.design.reshape(-1, len(z)) @ z
        return self.layout.unpad(changes.reshape(self.design.shape[:3]))

    def deviation(self, z: Array) -> Array:
        """Return the exact deviation (n, 3) in mm of the error model with the parameters contained in z, at the axis
        position of each of the n measured balls."""
        seen, parameters = self.observations, self.unknowns.parameters(z)
        deviation = np.zeros_like(seen.axis_positions)
        if not parameters.any():
            return deviation
        for tool, rows in _rows_by_tool(seen.tool):
            offset = seen.tool_offsets[tool]
            deviation[rows] = exact_deviation(self.unknowns.model, seen.axis_positions[rows], offset, parameters)
        return deviation

    def with_poses(self, poses: Poses) -> IdentificationProblem:
        """Return the problem with its design at other poses. Only the columns of the artefact's errors change."""
        layout, blocks = self.layout, self.blocks
        design = self.design.copy()
        rotation = np.repeat(poses.rotation, layout.width, axis=0)
        flat = design.reshape(-1, 3, blocks.size)
        _fill_artefact(flat, blocks, self.nuisance, layout.source, self.observations.ball[layout.source], rotation)
        return replace(self, poses=poses, design=design)

    def with_shifts(self, shifts: Sequence[BallShift], fields: Array) -> IdentificationProblem:
        """Return the problem with further unknowns: the sizes of the h `shifts`. `fields` (n, 3, h) contains the
        change of the left side (actual tool points) in mm for shifts of 1 mm."""
        sizes_mm = np.array([shift.size_mm for shift in shifts])
        columns = _lay_out(self.layout, fields * sizes_mm)
        unknowns = replace(self.unknowns, shifts=(*self.unknowns.shifts, *shifts))
        return replace(
            self,
            unknowns=unknowns,
            blocks=unknowns.blocks,
            known=None if self.known is None else self.known.extended(len(shifts)),
            direct=None if self.direct is None else self.direct.extended(len(shifts)),
            design=np.concatenate((self.design, columns), axis=3),
        )

    def with_rows(self, accepted: np.ndarray[Any, Any]) -> IdentificationProblem:
        """Return the problem restricted to the rows (measured balls) that the mask `accepted` (n,) marks."""
        layout = RowLayout.of(self.observations.position[accepted])
        local = self.local[accepted]
        seen = self.observations.select(accepted)
        nuisance = self.nuisance.with_rows(accepted)
        used = np.unique(self.observations.position, return_inverse=True)[1][accepted]
        alive = np.unique(used)
        poses = Poses(self.poses.rotation[alive], self.poses.translation[alive])
        return replace(
            self,
            observations=seen,
            layout=layout,
            local=local,
            sag=None if self.sag is None else self.sag[accepted],
            bending=None if self.bending is None else self.bending[accepted],
            arms=PoseArms.of(layout, local, self.arms.lines and self.arms.lines.select(alive)),
            nuisance=nuisance,
            poses=poses,
            design=_lay_out(layout, self.layout.unpad(self.design)[accepted]),
        )


def build_problem(
    family: Family, observations: Observations, artefact: Artefact, options: Options
) -> IdentificationProblem:
    """Build the identification problem, linearised at the rigid poses of the artefact that fit the measured points
    best.

    Raise DataError if a measured ball is not on the artefact, or if the prior is invalid.
    """
    _check_balls(observations, artefact)
    layout = RowLayout.of(observations.position)
    seen = observations if _is_sorted(layout.order) else observations.select(layout.order)
    local = _artefact_points(artefact, seen)
    lines = StraightLines.of(artefact, np.split(seen.ball, np.cumsum(layout.counts)[:-1]))
    nominal, points = _mount_rotations(seen, layout), tool_points(seen)
    poses = rigid_poses(layout, local, points, lines, nominal)
    bending = _bending(artefact, seen, layout, poses) if artefact.is_single_bar or artefact.sag_mm else None
    sag = artefact.sag_mm * bending if bending is not None and artefact.sag_mm else None
    if sag is not None:
        poses = rigid_poses(layout, local, points - sag, lines, nominal)
    unknowns = unknowns_of(family, artefact, seen, options)
    warmer_k = seen.temperature_c - artefact.reference_temperature_c
    nuisance = Nuisance(unknowns.artefact, unknowns.artefact.strain_rows(warmer_k), warmer_k)
    design = _design(unknowns, nuisance, seen, layout, poses, bending)
    return IdentificationProblem(
        unknowns=unknowns,
        known=None if options.carried_over is None else joint_prior_for(unknowns, options.carried_over),
        nuisance=nuisance,
        blocks=unknowns.blocks,
        observations=seen,
        layout=layout,
        local=local,
        sag=sag,
        bending=bending,
        sag_size_mm=artefact.expected_sag_mm,
        arms=PoseArms.of(layout, local, lines),
        poses=poses,
        design=design.reshape(layout.positions, layout.width, 3, -1),
        direct=direct_information(options.instruments, unknowns),
    )


def _only(z: Array, *blocks: slice) -> Array:
    """Return z (P,) with zeros outside the given blocks."""
    accepted = np.zeros_like(z)
    for block in blocks:
        accepted[block] = z[block]
    return accepted


def tool_points(observations: Observations) -> Array:
    """Return the nominal tool points (n, 3) in mm: the axis positions plus the tool offsets."""
    return np.asarray(observations.axis_positions + observations.tool_offsets[observations.tool])


def _check_balls(observations: Observations, artefact: Artefact) -> None:
    unknown = observations.ball >= artefact.count
    if unknown.any():
        row = int(np.argmax(unknown))
        raise DataError(
            f"ball {observations.ball[row]} is not on the artefact '{artefact.name}' with {artefact.count} balls",
            row=row,
            column="ball",
            hint="balls are numbered from 0 in the order of the artefact file",
        )


def _is_sorted(order: np.ndarray[Any, Any]) -> bool:
    return bool((order[1:] > order[:-1]).all())


def _artefact_points(artefact: Artefact, seen: Observations) -> Array:
    """Return points (n, 3) in mm in the artefact frame at the temperature of each row."""
    strain = artefact.cte_per_k * (seen.temperature_c - artefact.reference_temperature_c)
    return np.asarray(artefact.balls[seen.ball] * strain[:, None] + artefact.balls[seen.ball])


def _mount_rotations(seen: Observations, layout: RowLayout) -> Array | None:
    """Return the rotation (K, 3, 3) that the mount gives the artefact in each position, or None without azimuths."""
    if seen.azimuth_rad is None:
        return None
    first = np.cumsum(layout.counts) - layout.counts
    angles = zip(seen.azimuth_rad[first].tolist(), seen.elevation_rad[first].tolist(), strict=True)
    return np.stack([mount_pose(np.zeros(3), MountGeometry(), *pair).rotation for pair in angles])


def _bending(artefact: Artefact, seen: Observations, layout: RowLayout, poses: Poses) -> Array:
    """Return the displacement (n, 3) by gravity for a sag of 1: across the bar, in the vertical plane that contains it.

    It does not turn with the artefact if the bar is clamped with a roll.
    """
    along = poses.rotation[:, :, 0]
    downwards = -np.array([0.0, 0.0, 1.0]) + along * along[:, 2:]
    return np.asarray(artefact.droop_shape[seen.ball][:, None] * downwards[layout.index])


def _rows_by_tool(tools: np.ndarray[Any, Any]) -> list[tuple[int, slice | np.ndarray[Any, Any]]]:
    """Return each tool in use with the rows measured with it. If there is a single tool, its rows are given as a slice,
    which avoids a copy."""
    if (tools == tools[0]).all():
        return [(int(tools[0]), slice(None))]
    return [(int(tool), np.flatnonzero(tools == tool)) for tool in np.unique(tools)]


def _lay_out(layout: RowLayout, rows: Array) -> Array:
    """Lay sorted rows (n, ...) out as (K, width, ...). An empty slot repeats the first row of its position."""
    laid = rows if layout.full else rows.take(layout.source, axis=0)
    return laid.reshape(layout.positions, layout.width, *rows.shape[1:])


def _design(
    unknowns: Unknowns,
    nuisance: Nuisance,
    seen: Observations,
    layout: RowLayout,
    poses: Poses,
    bending: Array | None,
) -> Array:
    """Return the design (K·width, 3, P) of all slots for the P unknowns."""
    source, blocks = layout.source, unknowns.blocks
    at, tool = seen.axis_positions[source], seen.tool[source]
    if blocks.size == blocks.parameters.stop and (tool == tool[0]).all():
        return deviation_basis(unknowns.model, at, seen.tool_offsets[tool[0]], unknowns.scale)
    design = np.empty((len(source), 3, blocks.size))
    for number, rows in _rows_by_tool(tool):
        _fill_field(design, rows, unknowns, at[rows], seen.tool_offsets[number], seen.thermal_regressors[source][rows])
    rotation = np.repeat(poses.rotation, layout.width, axis=0)
    _fill_artefact(design, blocks, nuisance, source, seen.ball[source], rotation)
    if bending is not None:
        # what hangs lower than stated is subtracted from the tool points; it does not turn with the artefact
        sagging = unknowns.artefact.sag.standard_uncertainty_mm * bending[source]
        design[:, :, blocks.sag] = -sagging[:, :, None]
    return design


def _fill_field(
    design: Array,
    rows: slice | np.ndarray[Any, Any],
    unknowns: Unknowns,
    at: Array,
    tool_offset: Array,
    course: Array,
) -> None:
    basis, blocks, modes = deviation_basis(unknowns.model, at, tool_offset), unknowns.blocks, unknowns.modes
    design[rows, :, blocks.parameters] = basis * unknowns.scale
    if modes is not None:
        at_hand = basis if (tool_offset == modes.tool_offset).all() else None
        design[rows, :, blocks.misfit] = unknowns.misfit_mm * modes.at(at, at_hand)
    if unknowns.drift is not None:
        design[rows, :, blocks.drift] = unknowns.drift.columns(basis, course)


def _fill_artefact(
    design: Array, blocks: UnknownBlocks, nuisance: Nuisance, source: Rows, ball: Rows, rotation: Array
) -> None:
    # right side R (b + δb + δs b): derivatives enter with a minus, -R per certificate error and -R b per strain
    errors = nuisance.errors
    certificate = errors.certificate.reshape(len(errors.balls), 3, -1)
    design[:, :, blocks.certificate] = -(rotation @ certificate[ball])
    stretched = (rotation @ errors.balls[ball][:, :, None])[:, :, 0]
    design[:, :, blocks.strain] = -stretched[:, :, None] * nuisance.strain_rows[source][:, None, :]
