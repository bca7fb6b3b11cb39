"""The part of a table that correcting each joint alone can carry, and what is lost."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from drivers.roles import TableImage

Values = NDArray[np.float64]


@dataclass(frozen=True)
class OwnAxisPart:
    """Per axis the nominal positions and the correction along itself there, mm; `lost_mm` is the largest remainder.

    The correction at a position of an axis is the mean over all nodes there: least squares over the grid.
    """

    nominal_mm: tuple[Values, Values, Values] = field(repr=False)
    correction_mm: tuple[Values, Values, Values] = field(repr=False)
    lost_mm: float


def own_axis_part(table: TableImage) -> OwnAxisPart:
    """Lost is what other axes' positions change, and nothing along the axis itself."""
    corrections = table.counts.astype(np.float64) * table.resolution_mm
    nominal, along, lost = [], [], 0.0
    for axis in range(3):
        others = tuple(other for other in range(3) if other != axis)
        mean = corrections[..., axis].mean(axis=others, keepdims=True)
        lost = max(lost, float(np.abs(corrections[..., axis] - mean).max()))
        nominal.append(table.origin_mm[axis] + table.step_mm[axis] * np.arange(table.shape[axis], dtype=np.float64))
        along.append(mean.ravel())
    return OwnAxisPart((nominal[0], nominal[1], nominal[2]), (along[0], along[1], along[2]), lost)
