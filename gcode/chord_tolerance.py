"""Largest spacing of points on a corrected path for a given chord tolerance. The straight lines between the points then
deviate from the path by less than the tolerance.

The uncorrected path is M(s), a line or an arc as a function of the path length s. The correction is c, which is
trilinear in each cell of the compensation table. The corrected path is P(s) = M(s) + c(M(s)). The unit tangent of M is
d.

The deviation of P from a chord is zero at both ends of the chord. Consider a function that is zero at both ends of an
interval of length h. Its absolute value is at most h/4 times the total variation of its derivative, because the Green's
function of a stretched string of length h is at most h/4. The derivative P' varies for three reasons:

- At each crossed node plane of axis i (a plane of table nodes perpendicular to this axis), P' changes by up to |d_i|
  K_i. Here K_i is the largest jump of the slope of c along axis i.
- Inside a cell, P' changes by up to 2 (|d_y d_z| Q_yz + |d_x d_z| Q_xz + |d_x d_y| Q_xy) per mm. Here Q_yz, Q_xz and
  Q_xy are the largest mixed second derivatives of c.
- On an arc of curvature k, P' changes by up to k (1 + G) per mm. Here G is the largest slope of c. The arc itself,
  without a correction, deviates by only k h²/8.

Two node planes of one axis are at least one cell apart. A line of length h therefore crosses at most 1 + h |d_i| /
cell_i node planes of axis i, where cell_i is the smallest cell length. An arc may cross one more, because it may
reverse within the interval. The condition that the deviation is below the tolerance is thus a quadratic inequality for
h. K, Q and G are the largest values of the whole table. The computed spacing is therefore never too large, but often
smaller than necessary.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from twin.arrays import Array
from twin.compensation.table import CompensationTable

# The pairs of axes of the mixed derivatives yz, xz and xy, in the order of the axis that is missing.
_OTHERS = ((1, 2), (0, 2), (0, 1))


@dataclass(frozen=True, eq=False)
class TableCurvature:
    """Upper bounds on the changes of slope of a compensation table's corrections, valid for the whole table.

    - `kinks` (3,) contains the largest jump of the slope along x, y and z in mm/mm.
    - `mixed` (3,) contains the largest mixed second derivatives yz, xz and xy in 1/mm.
    - `gradient` is the largest slope in mm/mm.
    - `cells` (3,) contains the length of the smallest cell along each axis in mm.
    - `planes` contains the coordinates of the nodes of each axis in mm, at which the slope jumps.
    """

    planes: tuple[Array, Array, Array]
    cells: Array
    kinks: Array
    mixed: Array
    gradient: float

    @classmethod
    def of(cls, table: CompensationTable, *, beyond: bool) -> TableCurvature:
        """Compute the upper bounds on the changes of slope of a compensation table's corrections.

        `beyond` is True if paths may leave the volume of the table. Outside this volume the correction is constant, so
        the slope jumps to zero at the border.
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
        """Return the number of equal pieces into which each of n lines has to be divided to keep the chord tolerance
        after correction.

        `starts` and `ends` (n, 3) are the ends of the lines in mm. `limit_mm` is the chord tolerance.
        """
        way = ends - starts
        length = np.sqrt((way * way).sum(axis=1))
        direction = np.abs(way) / np.maximum(length, 1e-12)[:, None]
        # Jumps along an axis count only if the line touches a node plane of this axis at all.
        jumps = direction * self.kinks * self._crossed(np.minimum(starts, ends), np.maximum(starts, ends))
        # dP'/ds contains d_i d_j ∂²c/∂x_i∂x_j for every ordered pair of axes, so each mixed derivative counts twice.
        inside = 2.0 * sum(direction[:, i] * direction[:, j] * q for (i, j), q in zip(_OTHERS, self.mixed, strict=True))
        rate = (jumps * direction / self.cells).sum(axis=1) + inside
        return _pieces(length, jumps.sum(axis=1), rate, limit_mm)

    def arc_pieces(
        self, lower: Array, upper: Array, length: Array, curvature: Array, sweep: Array, limit_mm: float
    ) -> NDArray[np.int64]:
        """Return the number of pieces into which each of n arcs has to be divided to keep the chord tolerance after
        correction.

        `lower` and `upper` (n, 3) are corners in mm of a box that contains each arc. `length` is the length along the
        helix in mm, `curvature` is the largest curvature in 1/mm, and `sweep` is the angle of the arc in rad.
        `limit_mm` is the chord tolerance. No piece is longer than a quarter of a turn.
        """
        # The direction of an arc changes on its way, so every |d_i| is replaced by its bound 1.
        jumps = self.kinks * self._crossed(lower, upper)
        inside = 2.0 * float(self.mixed.sum())
        # The arc itself deviates by k h²/8, which is h/4 times k h/2: the share of k is 0.5 and not 1.
        rate = (jumps / self.cells).sum(axis=1) + inside + curvature * (self.gradient + 0.5)
        # Twice the jump: an arc may reverse and cross one more node plane than a line.
        pieces = _pieces(length, 2.0 * jumps.sum(axis=1), rate, limit_mm)
        # 1e-9 keeps an exact multiple of a quarter turn from being rounded up by floating-point noise.
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
    # R h² + J h - 4 L = 0 has the positive root h = 8 L / (J + √(J² + 16 R L)).
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
