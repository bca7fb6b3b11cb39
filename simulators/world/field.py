"""Deviation fields at one point, fast: the compensation table in the controller, and the machine as it is."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from drivers.roles import TableImage
from twin.arrays import Array
from twin.collision.geometry import Point, point, translate_point

FieldOfMany = Callable[[Array], Array]
"""(n, 3) bare axis positions in mm -> (n, 3) mm."""

ZERO: Point = (0.0, 0.0, 0.0)


class TableField:
    """What a controller adds to the commanded position: trilinear between nodes, the border's value outside."""

    def __init__(self, image: TableImage) -> None:
        self._origin = image.origin_mm
        self._step = image.step_mm
        self._shape = image.shape
        self._values = np.asarray(image.counts, dtype=np.float64) * image.resolution_mm

    def at_many(self, axis_positions: Array) -> Array:
        """(n, 3) displayed axis positions -> (n, 3) mm."""
        cell, share = self._located(axis_positions)
        total = np.zeros_like(axis_positions)
        for corner in np.ndindex(2, 2, 2):
            side = np.array(corner)
            index = np.minimum(cell + side, np.array(self._shape) - 1)
            weight = np.where(side == 1, share, 1.0 - share).prod(axis=1)
            total += weight[:, None] * self._values[index[:, 0], index[:, 1], index[:, 2]]
        return total

    def _located(self, axis_positions: Array) -> tuple[np.ndarray[tuple[int, ...], np.dtype[np.intp]], Array]:
        last = np.array(self._shape) - 1
        steps = np.clip((axis_positions - self._origin) / self._step, 0.0, last)
        cell = np.minimum(steps.astype(np.intp), np.maximum(last - 1, 0))
        return cell, steps - cell


class TipShift:
    """How far the tip centre is from (displayed axis position + tool offset).

    The drives go to the bare position X + table(X); the machine as it is adds its deviation there: that is the
    `field`, plus the `thermal` field. Thermal `drift` and the `play` that the last motion left (backlash,
    scatter) shift all of it. mm.
    """

    def __init__(self, machine: FieldOfMany | None) -> None:
        self._machine = machine
        self.table: TableField | None = None
        self.thermal: FieldOfMany | None = None
        self.drift: Point = ZERO
        self.play: Point = ZERO

    @property
    def has_field(self) -> bool:
        return not (self._machine is None and self.table is None and self.thermal is None)

    @property
    def rigid(self) -> Point:
        """What is the same everywhere: drift and play."""
        return translate_point(self.drift, self.play)

    def field_at(self, axis_position: Point) -> Point:
        return point(self.field_at_many(np.array([axis_position]))[0]) if self.has_field else ZERO

    def field_at_many(self, axis_positions: Array) -> Array:
        """(n, 3) displayed axis positions -> (n, 3) mm."""
        shift = np.zeros_like(axis_positions)
        if self.table is not None:
            shift += self.table.at_many(axis_positions)
        bare = axis_positions + shift
        for field in (self._machine, self.thermal):
            if field is not None:
                shift += field(bare)
        return shift
