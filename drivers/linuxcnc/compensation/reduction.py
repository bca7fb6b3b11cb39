"""Reduction of a compensation table to its own-axis part.

In the own-axis part, the correction of each axis depends only on the position of this axis. The rest of the table,
which depends on the positions of the other axes, is lost.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from drivers.roles import TableImage

Values = NDArray[np.float64]


@dataclass(frozen=True)
class OwnAxisPart:
    """Own-axis part of a compensation table: the correction of each axis as a function of its own position only.

    `nominal_mm` contains the node positions of each axis in the grid of the table. `correction_mm` contains the
    corrections along the axis at these positions. Each correction is the mean over all grid nodes that have this
    position of the axis, which is the least-squares fit over the grid. `lost_mm` is the largest absolute difference
    between the table and this fit.
    """

    nominal_mm: tuple[Values, Values, Values] = field(repr=False)
    correction_mm: tuple[Values, Values, Values] = field(repr=False)
    lost_mm: float


def own_axis_part(table: TableImage) -> OwnAxisPart:
    """Return the own-axis part of a compensation table: each correction depends on the position of its axis only.

    The part of a correction that depends on the positions of the other axes is lost; its largest value is returned,
    too.
    """
    corrections = table.counts.astype(np.float64) * table.resolution_mm
    nominal, along, lost = [], [], 0.0
    for axis in range(3):
        others = tuple(other for other in range(3) if other != axis)
        # c_a(x_a) = mean of the correction along axis a over the other two axes; the remainder is |c - c_a|.
        mean = corrections[..., axis].mean(axis=others, keepdims=True)
        lost = max(lost, float(np.abs(corrections[..., axis] - mean).max()))
        nominal.append(table.origin_mm[axis] + table.step_mm[axis] * np.arange(table.shape[axis], dtype=np.float64))
        along.append(mean.ravel())
    return OwnAxisPart((nominal[0], nominal[1], nominal[2]), (along[0], along[1], along[2]), lost)
