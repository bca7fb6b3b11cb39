"""Largest spacing of points on a corrected path at which the straight lines between them deviate less than a tolerance.

The corrected path is P(s) = M(s) + c(M(s)), with M a line or an arc as a function of its length s, and the correction c
trilinear in cells. For any function f that is zero at both ends of an interval of length h, |f| is at most h/4 times
the total variation of f' (the Green's function of the string is at most h/4). With d the unit tangent of M, P' varies

- by |d_i| K_i where a node plane of axis i is crossed, K_i the largest jump of the slope of c along axis i,
- by 2 (|d_y d_z| Q_yz + |d_x d_z| Q_xz + |d_x d_y| Q_xy) per mm inside a cell, Q the largest mixed second derivatives,
- by k (1 + G) per mm on an arc of curvature k, G the largest slope of c; a smooth arc alone deviates only by k h²/8.

Node planes of an axis are at least one cell apart, so an interval crosses at most 1 + h |d_i| / cell_i of them (2 + ...
for an arc, which may reverse within the interval). The tolerance thus becomes a quadratic inequality for h. K, Q and G
are bounds over the whole table, so the spacing is never too large, but often smaller than necessary.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from twin.arrays import Array
from twin.compensation.table import CompensationTable

_OTHERS = ((1, 2), (0, 2), (0, 1))


@dataclass(frozen=True, eq=False)
class TableCurvature:
    """Bounds on the slope changes of a table's corrections, over the whole table.

    `kinks` (3,) mm/mm: largest jump of the slope along x, y, z; `mixed` (3,) 1/mm: largest mixed second derivatives yz,
    xz, xy; `gradient` mm/mm: largest slope; `cells` (3,) mm: smallest cell of each axis; `planes`: node coordinates in
    mm of each axis, at which the slope jumps.
    """

    planes: tuple[Array, Array, Array]
    cells: Array
    kinks: Array
    mixed: Array
    gradient: float

    @classmethod
    def of(cls, table: CompensationTable, *, beyond: bool) -> TableCurvature:
        """Return the bounds of a table.

        `beyond`: True if paths may leave the table's volume. Outside it the correction is constant, so the slope jumps
        to zero at the border.
        """
        slopes = [_slopes(table.corrections, nodes, axis) for axis, nodes in enumerate(table.nodes)]
        acting = [_with_border(slope, axis) if beyond else slope for axis, slope in enumerate(slopes)]
        kinks = [_largest(np.diff(slope, axis=axis)) for axis, slope in enumerate(acting)]
        mixed = [_largest(_slopes(slopes[i], table.nodes[j], j)) for i, j in _OTHERS]
        return cls(
            planes=table.nodes,
            cells=np.array([np.diff(nodes).min() for nodes in table.nodes]),
            kinks=np.array(kinks),
            mixed=np.array(mixed),
            gradient=float(np.sqrt(sum(_largest(slope) ** 2 for slope in slopes))),
        )

    def line_pieces(self, starts: Array, ends: Array, limit_mm: float) -> NDArray[np.int64]:
        """Return for each line the number of equal pieces (n,) into which it has to be divided.

        `starts`, `ends` (n, 3) mm.
        """
        way = ends - starts
        length = np.sqrt((way * way).sum(axis=1))
        direction = np.abs(way) / np.maximum(length, 1e-12)[:, None]
        jumps = direction * self.kinks * self._crossed(np.minimum(starts, ends), np.maximum(starts, ends))
        inside = 2.0 * sum(direction[:, i] * direction[:, j] * q for (i, j), q in zip(_OTHERS, self.mixed, strict=True))
        rate = (jumps * direction / self.cells).sum(axis=1) + inside
        return _pieces(length, jumps.sum(axis=1), rate, limit_mm)

    def arc_pieces(
        self, lower: Array, upper: Array, length: Array, curvature: Array, sweep: Array, limit_mm: float
    ) -> NDArray[np.int64]:
        """Return for each arc the number of pieces (n,) into which it has to be divided.

        `lower`, `upper` (n, 3) mm: box that contains the arc; `length` mm: length along the helix; `curvature` 1/mm:
        largest curvature; `sweep` rad. A piece is never more than a quarter of a turn.
        """
        jumps = self.kinks * self._crossed(lower, upper)
        inside = 2.0 * float(self.mixed.sum())
        rate = (jumps / self.cells).sum(axis=1) + inside + curvature * (self.gradient + 0.5)
        pieces = _pieces(length, 2.0 * jumps.sum(axis=1), rate, limit_mm)
        return np.maximum(pieces, np.ceil(np.abs(sweep) / (0.5 * np.pi) - 1e-9).astype(np.int64))

    def _crossed(self, lower: Array, upper: Array) -> NDArray[np.bool_]:
        """Return (n, 3) bool: True if the box touches a node plane of the axis."""
        found = [
            np.searchsorted(nodes, lower[:, k], side="left") < np.searchsorted(nodes, upper[:, k], side="right")
            for k, nodes in enumerate(self.planes)
        ]
        return np.stack(found, axis=1)


def _pieces(length: Array, jump: Array, rate: Array, limit_mm: float) -> NDArray[np.int64]:
    """Return the smallest number of equal pieces whose length h satisfies h/4 (jump + rate h) <= `limit_mm`.

    The root of the quadratic is computed in its numerically stable form, without division by zero.
    """
    root = jump + np.sqrt(jump * jump + 16.0 * rate * limit_mm)
    return np.maximum(np.ceil(length * root / (8.0 * limit_mm) - 1e-9), 1.0).astype(np.int64)


def _slopes(values: Array, nodes: Array, axis: int) -> Array:
    shape = [1] * values.ndim
    shape[axis] = -1
    return np.asarray(np.diff(values, axis=axis) / np.diff(nodes).reshape(shape))


def _with_border(slope: Array, axis: int) -> Array:
    widths = [(0, 0)] * slope.ndim
    widths[axis] = (1, 1)
    return np.pad(slope, widths)


def _largest(vectors: Array) -> float:
    return float(np.sqrt((vectors * vectors).sum(axis=-1)).max(initial=0.0))
