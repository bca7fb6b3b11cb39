"""Fast evaluation of two functions of the axis position (fields): the correction by the controller's compensation
table, and the true machine's deviation.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from drivers.roles import TableImage
from twin.arrays import Array
from twin.collision.geometry import Point, point, translate_point

FieldOfMany = Callable[[Array], Array]
"""Deviation field: maps uncorrected axis positions (n, 3) in mm to deviations (n, 3) in mm."""

ZERO: Point = (0.0, 0.0, 0.0)

_CORNERS = np.array(list(np.ndindex(2, 2, 2)))
"""Corners (8, 3) of a cell of a table: 1 at its upper end along X, Y and Z, 0 at its lower end."""
_UPPER = _CORNERS == 1


class TableField:
    """Correction that a controller adds to the commanded axis position, from a compensation table.

    The correction is interpolated trilinearly between the nodes of the table and is constant outside the grid of nodes.
    """

    def __init__(self, image: TableImage) -> None:
        self._origin = image.origin_mm
        self._step = image.step_mm
        self._last = np.array(image.shape) - 1
        self._values = np.asarray(image.counts, dtype=np.float64) * image.resolution_mm

    def at_many(self, axis_positions: Array) -> Array:
        """Return the corrections, shape (n, 3), at n displayed axis positions, shape (n, 3), both in mm."""
        # Trilinear interpolation: sum over the 8 cell corners of node value times product of the axis weights. All
        # corners at once: at a single position, which is the usual call, a loop over them takes three times as long.
        cell, share = self._located(axis_positions)
        index = np.minimum(cell[:, None, :] + _CORNERS, self._last)
        share = share[:, None, :]
        weights = np.where(_UPPER, share, 1.0 - share).prod(axis=2)
        values = self._values[index[..., 0], index[..., 1], index[..., 2]]
        return np.asarray((weights[:, :, None] * values).sum(axis=1))

    def _located(self, axis_positions: Array) -> tuple[np.ndarray[tuple[int, ...], np.dtype[np.intp]], Array]:
        steps = np.clip((axis_positions - self._origin) / self._step, 0.0, self._last)
        cell = np.minimum(steps.astype(np.intp), np.maximum(self._last - 1, 0))
        return cell, steps - cell


class TipShift:
    """Offset in mm of the true tip centre from the nominal tip centre.

    The nominal tip centre is the displayed axis position plus the tool offset. If the axes display the position X, the
    drives go to X plus the correction of the compensation table at X. At that place of the drives the true machine has
    a deviation, with its `change` since the start of the simulation. The position-dependent part of the offset is the
    sum of correction, deviation and change.

    Three other parts are the same at every position. One is the thermal `drift`, the growth of spindle and ram. Another
    is the `play`, the error that the last motion leaves because of backlash and limited repeatability. The third is
    `homing`, the distance of the displayed zero from where it was before the last homing; the machine has its deviation
    at the place of the slides, which are displaced by it too.
    """

    def __init__(self, machine: FieldOfMany | None) -> None:
        self._machine = machine
        self.table: TableField | None = None
        self.change: FieldOfMany | None = None
        self.drift: Point = ZERO
        self.play: Point = ZERO
        self.homing: Point = ZERO

    @property
    def has_field(self) -> bool:
        return not (self._machine is None and self.table is None and self.change is None)

    @property
    def rigid(self) -> Point:
        """Part of the tip centre's offset in mm that is the same at every axis position: the sum of the thermal
        `drift`, the backlash error `play` and the offset of the last `homing`.
        """
        return translate_point(translate_point(self.drift, self.play), self.homing)

    def field_at(self, axis_position: Point) -> Point:
        return point(self.field_at_many(np.array([axis_position]))[0]) if self.has_field else ZERO

    def field_at_many(self, axis_positions: Array) -> Array:
        """Return the position-dependent part of the tip centre's offset, shape (n, 3), at n displayed axis positions,
        shape (n, 3), both in mm.
        """
        shift = np.zeros_like(axis_positions)
        if self.table is not None:
            shift += self.table.at_many(axis_positions)
        bare = axis_positions + shift + np.array(self.homing)
        for field in (self._machine, self.change):
            if field is not None:
                shift += field(bare)
        return shift
