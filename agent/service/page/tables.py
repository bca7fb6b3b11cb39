"""Kept tables as files, and how two of them differ."""

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
    """InputError where what was kept is that nothing was compensated."""
    if image is None:
        raise InputError(f"run {run_id} kept no compensation as {role}", hint="bank 0 holds no table: nothing to save")
    return format_table(table_of(image, tool_offset_mm))


def table_difference(one: TableImage | None, other: TableImage | None) -> Document:
    """`other` less `one` in µm at the nodes of either: per axis the largest difference with its place, and the rms.

    No compensation counts as zero. InputError for two tables on different grids.
    """
    image = other if one is None else one
    if image is None:
        return {"same": True, "nodes": 0, "axes": [], "crc32": [None, None]}
    if one is not None and other is not None and not _same_grid(one, other):
        raise InputError(
            "the two tables stand on different grids",
            hint="save both as files and compare the corrections where the grids meet",
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
    """(nx, ny, nz, 3) µm."""
    if table is None:
        return np.zeros((*like.shape, 3))
    return UM_PER_MM * table.resolution_mm * table.counts.astype(np.float64)


def _same_grid(one: TableImage, other: TableImage) -> bool:
    return (one.shape, one.origin_mm, one.step_mm) == (other.shape, other.origin_mm, other.step_mm)
