"""The table at one point: what is added to a commanded position, and the way back.

The same rule as a controller with a table has: trilinear between nodes, the border's value outside.
"""

from __future__ import annotations

import numpy as np

from drivers.roles import TableImage, Vector

ITERATIONS = 8
"""The table's slope is far below 1 (gates allow 0.5 µm/mm): each step gains three digits or more."""


class Correction:
    """A table, or none: then nothing is corrected. mm, axis positions as the controller displays them."""

    def __init__(self, table: TableImage | None) -> None:
        self._table = table
        if table is not None:
            self._values = table.counts.astype(np.float64) * table.resolution_mm
            self._origin = np.array(table.origin_mm)
            self._step = np.array(table.step_mm)
            self._last = np.array(table.shape) - 1

    def at(self, position_mm: Vector) -> Vector:
        """(3,): what is added there."""
        if self._table is None:
            return np.zeros(3)
        steps = np.clip((position_mm - self._origin) / self._step, 0.0, self._last)
        cell = np.minimum(steps.astype(np.intp), np.maximum(self._last - 1, 0))
        share = steps - cell
        upper = np.minimum(cell + 1, self._last)
        values = self._values[cell[0] : upper[0] + 1, cell[1] : upper[1] + 1, cell[2] : upper[2] + 1]
        for axis in range(3):
            first = values[0]
            values = first + share[axis] * (values[-1] - first)
        result: Vector = values
        return result

    def apply(self, position_mm: Vector) -> Vector:
        """Displayed -> what the axes are sent to."""
        return position_mm + self.at(position_mm)

    def remove(self, sent_mm: Vector) -> Vector:
        """What the axes were sent to -> displayed."""
        if self._table is None:
            return sent_mm
        displayed = sent_mm
        for _ in range(ITERATIONS):
            displayed = sent_mm - self.at(displayed)
        return displayed
