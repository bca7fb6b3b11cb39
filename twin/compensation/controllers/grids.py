"""Checks of a compensation table against the requirements of a controller, and resampling of the table to a different
grid. The requirements concern the spacing, the number of points and the size of the values.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from twin.arrays import Array
from twin.compensation.table import CompensationTable
from twin.errors import DataError
from twin.machine.kinematic_chain import AXES

LARGEST_CORRECTION_MM = 1.0
"""Largest plausible correction in mm; also the default of Siemens MD32720 $MA_CEC_MAX_SUM."""

_EVEN = 1e-6  # relative to a step
_ON_A_NODE_MM = 1e-6
_HEADER_LINES = 1

Shape = tuple[int, int, int]


def require_small_corrections(table: CompensationTable, largest_mm: float = LARGEST_CORRECTION_MM) -> None:
    """Raise DataError if the largest correction of a compensation table exceeds `largest_mm`.

    The error names the line of the table's CSV file in which the largest correction is stored.
    """
    sizes = np.abs(table.corrections).max(axis=-1)
    index = int(np.argmax(sizes))
    found = float(sizes.reshape(-1)[index])
    if found > largest_mm:
        message = f"a correction of {1e3 * found:.1f} µm is larger than {1e3 * largest_mm:g} µm"
        hint = "Check in the report that the table is plausible before you raise the limit with --largest-um"
        raise DataError(message, hint=hint, row=index + 1 + _HEADER_LINES)


def even_steps(table: CompensationTable) -> tuple[float, float, float]:
    """Return the distances between successive nodes of a compensation table along X, Y and Z in mm.

    Raises DataError if the nodes are not evenly spaced. The error names the axis and the line in the CSV file of the
    table.
    """
    steps = []
    # Lines of the CSV file from one node of an axis to the next: Z varies fastest.
    lines = (len(table.y) * len(table.z), len(table.z), 1)
    for axis, nodes, stride in zip(AXES, table.nodes, lines, strict=True):
        step = float(nodes[-1] - nodes[0]) / (len(nodes) - 1)
        off = np.abs(nodes - (nodes[0] + step * np.arange(len(nodes))))
        if off.max() > _EVEN * step:
            index = int(np.argmax(off > _EVEN * step))
            message = f"the node {nodes[index]:g} mm breaks the even spacing that this format needs"
            hint = "Choose an evenly spaced grid with --points, such as --points 41x14x16"
            raise DataError(message, hint=hint, axis=axis, row=index * stride + 1 + _HEADER_LINES)
        steps.append(step)
    return steps[0], steps[1], steps[2]


def require_points(table: CompensationTable, most: Shape, format_name: str) -> None:
    """Raise DataError if the table has more points along an axis than the limit `most` of an export format."""
    found = table.corrections.shape[:3]
    if any(count > limit for count, limit in zip(found, most, strict=True)):
        axis = AXES[next(k for k in range(3) if found[k] > most[k])]
        fitting = "x".join(str(_thinned(count, limit)) for count, limit in zip(found, most, strict=True))
        message = f"{found[AXES.index(axis)]} points, but {format_name} allows {most[AXES.index(axis)]}"
        raise DataError(message, hint=f"Thin the grid with --points {fitting}", axis=axis)


def _thinned(count: int, most: int) -> int:
    """Return the largest number of points, at most `most`, that an evenly spaced subset of `count` points can have.

    With a subset of the original points the steps remain round numbers.
    """
    # Every k-th point, both ends included: n - 1 divides count - 1.
    return next(n for n in range(min(count, most), 1, -1) if (count - 1) % (n - 1) == 0)


def resample_table(table: CompensationTable, points: Shape) -> CompensationTable:
    """Return the compensation table on an evenly spaced grid over the same range, with the given number of `points`
    along each axis. The corrections at the new nodes are interpolated trilinearly.

    A new node is marked as extrapolated if its interpolated value depends on a node of the old grid that is marked as
    extrapolated, that is, outside the measured region.
    """
    if min(points) < 2:
        raise DataError(
            f"a grid of {'x'.join(map(str, points))} points is not a grid", hint="Use at least 2 along each axis"
        )
    x, y, z = (np.linspace(nodes[0], nodes[-1], count) for nodes, count in zip(table.nodes, points, strict=True))
    positions = np.stack(np.meshgrid(x, y, z, indexing="ij"), axis=-1).reshape(-1, 3)
    marks = replace(table, corrections=np.repeat(table.extrapolated[..., None].astype(np.float64), 3, axis=-1))
    return replace(
        table,
        x=x,
        y=y,
        z=z,
        corrections=table.at(positions).reshape(*points, 3),
        # The interpolated mark is the total weight of the marked nodes.
        extrapolated=(marks.at(positions)[:, 0] > 1e-9).reshape(points),
    )


def reference_point(table: CompensationTable, wanted_mm: tuple[float, float, float] | None) -> Array:
    """Return the machine position (3,) in mm of the reference point, to which a controller refers its compensation. If
    `wanted_mm` is None, the reference point is the anchor of the table (the position at which its correction is zero).

    Raises DataError if the reference point is outside the grid.
    """
    point = table.anchor.point_mm if wanted_mm is None else np.array(wanted_mm, dtype=np.float64)
    for axis, nodes, value in zip(AXES, table.nodes, point.tolist(), strict=True):
        if not nodes[0] - _ON_A_NODE_MM <= value <= nodes[-1] + _ON_A_NODE_MM:
            message = f"the reference point {value:g} mm is outside the table, {nodes[0]:g} to {nodes[-1]:g} mm"
            raise DataError(message, hint="Give a machine position inside it with --reference-mm", axis=axis)
    return point


def reference_nodes(table: CompensationTable, point: Array) -> Shape:
    """Return for each axis the index of the table node at the reference point `point`.

    Raises DataError if the grid has no node at the reference point along one of the axes.
    """
    indices = []
    for axis, nodes, value in zip(AXES, table.nodes, point.tolist(), strict=True):
        index = int(np.argmin(np.abs(nodes - value)))
        if abs(float(nodes[index]) - value) > _ON_A_NODE_MM:
            message = f"no point of the grid is at the reference point {value:g} mm"
            hint = f"The nearest one is at {nodes[index]:g} mm: choose another grid with --points"
            raise DataError(message, hint=hint, axis=axis)
        indices.append(index)
    return indices[0], indices[1], indices[2]
