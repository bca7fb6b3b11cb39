"""Application of the correction of a compensation table to a position, and its inverse.

Interpolation is the same as in a controller that stores tables: trilinear between nodes. Outside the grid, the
correction at the nearest point of the grid's border applies.
"""

from __future__ import annotations

import numpy as np

from drivers.roles import TableImage, Vector

ITERATIONS = 8
"""Number of fixed-point iterations of the inverse.

The slope of a table is far below 1 (the gates allow 0.5 µm/mm), so each iteration gains three digits or more.
"""


class Correction:
    """Correction that a compensation table defines. Without a table, the correction is zero.

    The grid of the table and the positions are displayed axis positions in mm.
    """

    def __init__(self, table: TableImage | None) -> None:
        self._table = table
        if table is not None:
            self._values = table.counts.astype(np.float64) * table.resolution_mm
            self._origin = np.array(table.origin_mm)
            self._step = np.array(table.step_mm)
            self._last = np.array(table.shape) - 1

    def at(self, position_mm: Vector) -> Vector:
        """Return the correction in mm, shape (3,), at the displayed axis position `position_mm`."""
        if self._table is None:
            return np.zeros(3)
        # Grid coordinates, limited to the grid; `cell` is the lower node of the cell, `share` the position within it.
        steps = np.clip((position_mm - self._origin) / self._step, 0.0, self._last)
        cell = np.minimum(steps.astype(np.intp), np.maximum(self._last - 1, 0))
        share = steps - cell
        upper = np.minimum(cell + 1, self._last)
        values = self._values[cell[0] : upper[0] + 1, cell[1] : upper[1] + 1, cell[2] : upper[2] + 1]
        # Trilinear interpolation, one axis after the other: v = v0 + share (v1 - v0).
        for axis in range(3):
            first = values[0]
            values = first + share[axis] * (values[-1] - first)
        result: Vector = values
        return result

    def apply(self, position_mm: Vector) -> Vector:
        """Return the commanded axis position for the displayed axis position `position_mm`: commanded = displayed +
        correction(displayed).
        """
        return position_mm + self.at(position_mm)

    def remove(self, sent_mm: Vector) -> Vector:
        """Return the displayed position for a commanded position, as the inverse of `apply`.

        The result is found by the fixed-point iteration displayed = commanded - correction(displayed).
        """
        if self._table is None:
            return sent_mm
        displayed = sent_mm
        for _ in range(ITERATIONS):
            displayed = sent_mm - self.at(displayed)
        return displayed
