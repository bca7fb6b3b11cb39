"""Linear part of a compensation table, for controllers that correct by a constant matrix: scales and squareness.

The matrix is the least-squares fit of an affine field to the corrections at the nodes. Its constant part is a
translation of the whole workspace, which no machine error depends on, and is dropped.
"""

from __future__ import annotations

import numpy as np

from twin.arrays import Array
from twin.compensation.controllers.export_format import Correction
from twin.compensation.table import CompensationTable
from twin.errors import DataError
from twin.machine.rigid_motion import rigid_fields

LEAST_SHARE = 0.05
"""Smallest share of the table's corrections, rms after the best rigid motion, that a linear format must apply."""


def linear_part(table: CompensationTable) -> Array:
    """Return the matrix (3, 3), in mm per mm, by which the corrections depend on the axis positions."""
    points, corrections = _nodes(table)
    affine = np.column_stack([np.ones(len(points)), points - points.mean(axis=0)])
    return np.asarray(np.linalg.lstsq(affine, corrections, rcond=None)[0][1:].T, dtype=np.float64)


def shears(matrix: Array) -> tuple[float, float, float]:
    """Return the shears xy, xz and yz of a matrix without its rotation: how X must change with Y and with Z, and Y with
    Z, while the X axis keeps its direction and the XY plane its orientation.
    """
    # A small rotation is the antisymmetric part of the matrix. Of M = S + W, the shears with X and XY fixed are 2 S_xy,
    # 2 S_xz and 2 S_yz: the rotation that brings the lower triangle to zero doubles the upper.
    sums = matrix + matrix.T
    return float(sums[0, 1]), float(sums[0, 2]), float(sums[1, 2])


def require_worthwhile(table: CompensationTable, correction: Correction, format_name: str) -> int:
    """Return the share of the table's corrections, in percent, that `correction` applies.

    Both are compared after the best rigid motion. Raises DataError if the share is too small to be worth a change of
    the machine.
    """
    points, corrections = _nodes(table)
    whole = _rms_without_rigid_motion(points, corrections)
    left = _rms_without_rigid_motion(points, corrections - correction(points))
    share = 1.0 - left / whole if whole > 0.0 else 1.0
    if share < LEAST_SHARE:
        message = f"{format_name} can apply only {100.0 * max(share, 0.0):.0f} % of this table's corrections"
        hint = "This machine's errors are not linear in the axis positions: choose a format that holds a table"
        raise DataError(message, hint=hint)
    return round(100.0 * share)


def _nodes(table: CompensationTable) -> tuple[Array, Array]:
    points = np.stack(np.meshgrid(*table.nodes, indexing="ij"), axis=-1).reshape(-1, 3)
    return points, table.corrections.reshape(-1, 3)


def _rms_without_rigid_motion(points: Array, field: Array) -> float:
    fields = rigid_fields(points, points.mean(axis=0), 1.0).reshape(-1, 6)
    flat = field.reshape(-1)
    motion = np.linalg.lstsq(fields, flat, rcond=None)[0]
    # `flat` contains coordinates, three per point: the mean square length is three times their mean square
    return float(np.sqrt(3.0 * np.mean((flat - fields @ motion) ** 2)))
