"""Deflection file (CSV): the displacement of the tool point at each node of a grid, one line per node.

The columns are `x_mm,y_mm,z_mm,ux_um,uy_um,uz_um`, in any order. The columns x, y and z contain the axis positions of
the node; the columns ux, uy and uz contain the displacement.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from operator import itemgetter

import numpy as np
from numpy.typing import NDArray

from twin.arrays import Array
from twin.errors import FormatError, ModelError
from twin.formats.csv_reading import csv_lines
from twin.machine.deflection import DeflectionGrid
from twin.machine.kinematic_chain import AXES

COLUMNS = ("x_mm", "y_mm", "z_mm", "ux_um", "uy_um", "uz_um")
_SAME_NODE_DIGITS = 6  # coordinates equal to a nanometre are the same node: exports differ in their last digits


def parse_deflection(text: str, source: str) -> DeflectionGrid:
    """Return the deflection grid (displacements of the tool point at the nodes of a grid) given as CSV text. Raise
    FormatError, which names `source`, the row (the header is row 1) and the column, if the text is invalid."""
    table, rows = _numbers(text, source)
    nodes, node_indices = [], []
    for axis in range(3):
        unique, inverse = np.unique(np.round(table[:, axis], _SAME_NODE_DIGITS), return_inverse=True)
        nodes.append(unique)
        node_indices.append(inverse.reshape(-1))
    flat = np.ravel_multi_index(tuple(node_indices), tuple(n.size for n in nodes))
    _check_complete(flat, nodes, rows, source)
    values = np.empty_like(table[:, 3:])
    values[flat] = 1e-3 * table[:, 3:]
    try:
        return DeflectionGrid(nodes[0], nodes[1], nodes[2], values.reshape(*(n.size for n in nodes), 3))
    except ModelError as error:
        raise FormatError(error.message, hint=error.hint, file=source, **error.where) from None


def format_deflection(grid: DeflectionGrid) -> str:
    """Return a deflection grid (displacements of the tool point at the nodes of a grid) as CSV text. In the sequence of
    lines, z varies fastest and x slowest. Displacements are rounded to 0.1 nm."""
    x, y, z = (values.reshape(-1) for values in np.meshgrid(*grid.nodes, indexing="ij"))
    lines = [",".join(COLUMNS)]
    for point, displacement in zip(zip(x, y, z, strict=True), grid.values.reshape(-1, 3), strict=True):
        coordinates = [f"{round(float(value), _SAME_NODE_DIGITS):.10g}" for value in point]
        lines.append(",".join(coordinates + [f"{1e3 * float(value) + 0.0:.4f}" for value in displacement]))
    return "\n".join(lines).replace("-0.0000", "0.0000") + "\n"


def _numbers(text: str, source: str) -> tuple[Array, list[int]]:
    """Return the values (n, 6) of n lines, with columns in the order of `COLUMNS`, and the row number of each line in
    the file."""
    lines = csv_lines(text, source)
    header = [name.strip() for name in next(lines, (1, []))[1]]
    _check_header(header, source)
    order = [header.index(name) for name in COLUMNS]
    in_order = itemgetter(*order)
    table, rows = [], []
    for number, cells in lines:
        values = _finite(in_order(cells)) if len(cells) == len(header) else None
        if values is None:
            if not any(cell.strip() for cell in cells):
                continue
            if len(cells) != len(header):
                message = f"{len(cells)} values, but the header names {len(header)} columns"
                raise FormatError(message, file=source, row=number)
            values = [_number(cells[k], header[k], number, source) for k in order]
        table.append(values)
        rows.append(number)
    if not table:
        raise FormatError("no node follows the header", file=source)
    return np.array(table), rows


def _check_header(header: list[str], source: str) -> None:
    hint = f"The first line must be {','.join(COLUMNS)}"
    for name in COLUMNS:
        if header.count(name) != 1:
            problem = "is missing" if name not in header else "appears more than once"
            raise FormatError(f"column '{name}' {problem}", hint=hint, file=source, row=1)
    for name in header:
        if name not in COLUMNS:
            raise FormatError(f"unknown column '{name}'", hint=hint, file=source, row=1)


def _finite(cells: Sequence[str]) -> list[float] | None:
    """Return the numbers in the cells; None unless all are finite. A grid has thousands of rows, nearly always good."""
    try:
        values = list(map(float, cells))
    except ValueError:
        return None
    return values if all(map(math.isfinite, values)) else None


def _number(cell: str, column: str, row: int, source: str) -> float:
    try:
        value = float(cell)
    except ValueError:
        raise FormatError(f"'{cell.strip()}' is not a number", file=source, row=row, column=column) from None
    if not math.isfinite(value):
        raise FormatError(f"'{cell.strip()}' is not finite", file=source, row=row, column=column)
    return value


def _check_complete(flat: NDArray[np.intp], nodes: list[Array], rows: list[int], source: str) -> None:
    first_seen: dict[int, int] = {}
    for node, row in zip(flat.tolist(), rows, strict=True):
        if node in first_seen:
            raise FormatError(f"the node of row {first_seen[node]} is repeated", file=source, row=row)
        first_seen[node] = row
    shape = tuple(n.size for n in nodes)
    count = math.prod(shape)
    if len(first_seen) == count:
        return
    missing = next(node for node in range(count) if node not in first_seen)
    index = np.unravel_index(missing, shape)
    where = ", ".join(f"{axis} {n[k]:g}" for axis, n, k in zip(AXES, nodes, index, strict=True))
    sizes = " x ".join(str(size) for size in shape)
    message = f"{count - len(first_seen)} of {count} nodes of the {sizes} grid are missing, the first at {where}"
    raise FormatError(message, hint="A grid needs one line for every combination of x, y and z", file=source)
