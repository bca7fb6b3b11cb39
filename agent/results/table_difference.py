"""Difference of two compensation tables as a controller stores them, node by node."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from agent.execution.encoding import table_digest
from drivers.errors import InputError
from drivers.roles import TableImage
from twin.arrays import Array
from twin.machine.kinematic_chain import AXES
from twin.units import UM_PER_MM


@dataclass(frozen=True, eq=False)
class TableDifference:
    """Difference of the corrections of two tables over the nodes of their common grid.

    `change_um` (nx, ny, nz, 3) is the second table minus the first, in µm; its first three axes belong to the nodes
    `nodes_mm`, which holds the coordinates of the nodes along X, Y and Z. `checksums` are those of the two tables, None
    for a bank without compensation.
    """

    nodes_mm: tuple[Array, Array, Array]
    change_um: Array
    checksums: tuple[int | None, int | None]

    def as_json(self) -> dict[str, Any]:
        """Return the largest change, its place and the rms change for each axis, in µm and mm."""
        return {
            "same": not self.change_um.any(),
            "nodes": int(np.prod(self.change_um.shape[:3])),
            "axes": [self._axis(axis) for axis in range(len(AXES))] if self.change_um.size else [],
            "crc32": [None if one is None else f"{one:08x}" for one in self.checksums],
        }

    def _axis(self, axis: int) -> dict[str, Any]:
        change = self.change_um[..., axis]
        place = np.unravel_index(int(np.abs(change).argmax()), change.shape)
        return {
            "axis": AXES[axis],
            "largest_um": float(change[place]),
            "at_mm": [float(nodes[index]) for nodes, index in zip(self.nodes_mm, place, strict=True)],
            "rms_um": float(np.sqrt(np.mean(change**2))),
        }


def table_difference(one: TableImage | None, other: TableImage | None) -> TableDifference:
    """Return the difference `other` minus `one`. A table that is None counts as zero; two of these have no nodes.

    Raise InputError if the tables have different grids.
    """
    checksums = (None if one is None else table_digest(one), None if other is None else table_digest(other))
    image = other if one is None else one
    if image is None:
        return TableDifference((np.zeros(0), np.zeros(0), np.zeros(0)), np.zeros((0, 0, 0, 3)), checksums)
    if one is not None and other is not None and not _same_grid(one, other):
        raise InputError(
            "the two tables have different grids",
            hint="save both as files and compare the corrections at common nodes",
        )
    x, y, z = (
        origin + step * np.arange(count, dtype=np.float64)
        for origin, step, count in zip(image.origin_mm, image.step_mm, image.shape, strict=True)
    )
    return TableDifference((x, y, z), _corrections_um(other, image) - _corrections_um(one, image), checksums)


def _corrections_um(table: TableImage | None, like: TableImage) -> Array:
    """Return the corrections in µm as an array of shape (nx, ny, nz, 3). If `table` is None, they are zeros on the grid
    of `like`.
    """
    if table is None:
        return np.zeros((*like.shape, 3))
    return UM_PER_MM * table.resolution_mm * table.counts.astype(np.float64)


def _same_grid(one: TableImage, other: TableImage) -> bool:
    return (one.shape, one.origin_mm, one.step_mm) == (other.shape, other.origin_mm, other.step_mm)
