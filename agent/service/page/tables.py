"""Stored compensation tables as CSV files, and the difference between two tables."""

from __future__ import annotations

from typing import Any

import numpy as np

from agent.execution.encoding import table_digest
from agent.results.table_image import table_of
from drivers.errors import InputError
from drivers.roles import TableImage
from twin.arrays import Array
from twin.compensation.table_file import format_table
from twin.machine.kinematic_chain import AXES
from twin.units import UM_PER_MM

Document = dict[str, Any]


def table_csv(image: TableImage | None, tool_offset_mm: Array, run_id: str, role: str) -> str:
    """Return a stored table as CSV text. Raise InputError if `image` is None, which means that bank 0, without a table,
    was active when the run stored this entry."""
    if image is None:
        raise InputError(f"run {run_id} stored no table as {role}", hint="bank 0 contains no table")
    return format_table(table_of(image, tool_offset_mm))


def table_difference(one: TableImage | None, other: TableImage | None) -> Document:
    """Return a document with the difference `other` minus `one` over all nodes of the grid, in µm.

    For each axis the document contains the largest difference, its location and the rms difference. A table that is
    None counts as zero. Raise InputError if the tables have different grids.
    """
    image = other if one is None else one
    if image is None:
        return {"same": True, "nodes": 0, "axes": [], "crc32": [None, None]}
    if one is not None and other is not None and not _same_grid(one, other):
        raise InputError(
            "the two tables have different grids",
            hint="save both as files and compare the corrections at common nodes",
        )
    change = _corrections(other, image) - _corrections(one, image)
    return {
        "same": not change.any(),
        "nodes": int(np.prod(image.shape)),
        "axes": [_axis(change[..., axis], image, AXES[axis]) for axis in range(len(AXES))],
        "crc32": [None if table is None else f"{table_digest(table):08x}" for table in (one, other)],
    }


def _axis(change: Array, image: TableImage, axis: str) -> Document:
    place = np.unravel_index(int(np.abs(change).argmax()), change.shape)
    at = [o + s * float(n) for o, s, n in zip(image.origin_mm, image.step_mm, place, strict=True)]
    return {
        "axis": axis,
        "largest_um": float(change[place]),
        "at_mm": at,
        "rms_um": float(np.sqrt(np.mean(change**2))),
    }


def _corrections(table: TableImage | None, like: TableImage) -> Array:
    """Return the corrections in µm as an array of shape (nx, ny, nz, 3). If `table` is None, they are zeros on the grid
    of `like`.
    """
    if table is None:
        return np.zeros((*like.shape, 3))
    return UM_PER_MM * table.resolution_mm * table.counts.astype(np.float64)


def _same_grid(one: TableImage, other: TableImage) -> bool:
    return (one.shape, one.origin_mm, one.step_mm) == (other.shape, other.origin_mm, other.step_mm)
