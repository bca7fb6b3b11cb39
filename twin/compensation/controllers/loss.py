"""Volumetric error without a compensation table, with the full table, and with the reduced form of the table that a
controller supports.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from twin.arrays import Array
from twin.compensation.controllers.export_format import Correction, ExportSource, TableEstimate
from twin.compensation.table import CompensationTable
from twin.errors import DataError
from twin.machine.forward_model import exact_deviation
from twin.machine.rigid_motion import rigid_fields
from twin.machine.volumetric import QuadraticForm, VolumetricRms, evaluation_grid, rms, volumetric_error

LARGEST_MISMATCH_MM = 3e-4
"""Largest permissible rms difference in mm between a table and its estimate.

A rigid motion and the rounding of the table are not counted.
"""


@dataclass(frozen=True)
class CompensationLoss:
    """Volumetric error over the workspace without a compensation table (`before`), with the full table (`full`), and
    with the reduced form of the table that the controller supports (`reduced`).

    If `estimated` is True, the error is that of the estimated machine. If it is False, there is no estimate, and the
    errors of the machine are inferred from the table. `unknown_mm` is the contribution of the uncertainty of the
    estimated machine parameters (rms after the best rigid motion is removed). It does not depend on the table. It is
    None if there is no estimate.
    """

    before: VolumetricRms
    full: VolumetricRms
    reduced: VolumetricRms
    estimated: bool
    unknown_mm: float | None

    @property
    def retained_share(self) -> float:
        """Improvement of the volumetric error by the reduced table, which the controller supports, divided by the
        improvement by the full table.

        Both improvements are computed from aligned errors, that is, after the best rigid motion is removed. The share
        is 1 if the full table brings no improvement.
        """
        removed = self.before.aligned_mm - self.full.aligned_mm
        return (self.before.aligned_mm - self.reduced.aligned_mm) / removed if removed > 0.0 else 1.0


def compensation_loss(source: ExportSource, correction: Correction) -> CompensationLoss:
    """Compute the volumetric error without a compensation table, with the full table, and with the reduced form of the
    table that the controller supports. The function `correction` gives the corrections of the reduced table. The error
    is computed on a grid of 60 × 20 × 20 points.
    """
    table, identified = source.table, source.estimate
    grid = evaluation_grid(_ranges(table))
    tool_points = grid + table.tool_offset

    def left(added: Array) -> VolumetricRms:
        # The table moves the axes by `added`. What remains is this displacement plus the error at the place where the
        # axes are then.
        return volumetric_error(tool_points, added + _deviation(source, grid + added))

    return CompensationLoss(
        before=left(np.zeros_like(grid)),
        full=left(table.at(grid)),
        reduced=left(correction(grid)),
        estimated=identified is not None,
        unknown_mm=None if identified is None else _unknown(identified, grid, table.tool_offset),
    )


def largest_correction(table: CompensationTable, correction: Correction) -> tuple[Array, Array]:
    """Return the table node (3,) with the largest correction, and the correction (3,) at this node, both in mm. The
    function `correction` gives the corrections that the controller adds. With these values the operator can check the
    sign. If the compensation is switched on while the axes are at this node, they must move by this correction.
    """
    nodes = np.stack(np.meshgrid(*table.nodes, indexing="ij"), axis=-1).reshape(-1, 3)
    added = correction(nodes)
    index = int(np.argmax(np.einsum("ij,ij->i", added, added)))
    return nodes[index], added[index]


def require_same_machine(source: ExportSource, resolution_mm: float = 0.0) -> None:
    """Raise DataError if the compensation table and the estimate of the machine errors do not belong to the same
    machine, the same tool and the same night.

    `resolution_mm` is the resolution of the numbers in the stored table. The permissible rms difference between table
    and estimate is increased by `resolution_mm`. Rounding contributes only about half of this resolution (rms length
    over three axes).
    """
    identified, table = source.estimate, source.table
    if identified is None:
        return
    hint = "Give table and estimate of the same run: --table RUN_FOLDER reads both"
    for axis, nodes, (low, high) in zip("XYZ", table.nodes, identified.model.ranges_mm, strict=True):
        # 1 nm, for the rounding of the nodes in the file.
        if nodes[0] < low - 1e-6 or nodes[-1] > high + 1e-6:
            message = f"the table from {nodes[0]:g} to {nodes[-1]:g} mm exceeds the range of the estimate's machine"
            raise DataError(message, hint=hint, axis=axis)
    apart = rms(rigid_difference(source)[1])
    if apart > LARGEST_MISMATCH_MM + resolution_mm:
        message = (
            f"table and estimate differ by {1e3 * apart:.2f} µm rms: they are not of the same machine, tool or night"
        )
        raise DataError(message, hint=hint)


def rigid_difference(source: ExportSource) -> tuple[Array, Array]:
    """Return the deviation that remains if the compensation table corrects the estimated machine. It is returned in two
    parts, a rigid motion (6,) and a residual (n, 3) in mm at the n nodes of the table.

    The rigid motion is given by the coefficients of the six fields of `rigid_fields` (small translations and rotations)
    about the anchor of the table. Raises DataError if there is no estimate.
    """
    identified, table = source.estimate, source.table
    if identified is None:
        raise DataError(
            "a table alone does not determine the errors of the machine", hint="Give the estimate with --estimate"
        )
    points = np.stack(np.meshgrid(*table.nodes, indexing="ij"), axis=-1).reshape(-1, 3)
    added = table.corrections.reshape(-1, 3)
    # The same sum as in `compensation_loss`, at the nodes, and a least-squares fit of the six rigid fields to it.
    left = added + exact_deviation(identified.model, points + added, table.tool_offset, identified.parameters)
    fields = rigid_fields(points, table.anchor.point_mm, 1.0)
    motion = np.linalg.lstsq(fields.reshape(-1, 6), left.reshape(-1), rcond=None)[0]
    return np.asarray(motion, dtype=np.float64), left - fields @ motion


def _deviation(source: ExportSource, axis_positions: Array) -> Array:
    identified, table = source.estimate, source.table
    if identified is None:
        return -table.at(axis_positions)
    return exact_deviation(identified.model, axis_positions, table.tool_offset, identified.parameters)


def _unknown(identified: TableEstimate, grid: Array, tool_offset: Array) -> float:
    form = QuadraticForm.build(identified.model, grid, tool_offset)
    return form.expected(identified.covariance).aligned_mm


def _ranges(table: CompensationTable) -> tuple[tuple[float, float], tuple[float, float], tuple[float, float]]:
    x, y, z = ((float(nodes[0]), float(nodes[-1])) for nodes in table.nodes)
    return x, y, z
