"""CSV files around results of finite element programs: the results themselves, and the axis positions of load steps.

Table of positions: `x_mm,y_mm,z_mm` and, as far as needed, `file`, `load_step`, `node` and the place at which a mesh is
read, `probe_x,probe_y,probe_z` in the frame and the unit of the model.

Results: `ux,uy,uz` and, if there are rotations in rad, `rotx,roty,rotz`; either with the axis positions themselves in
`x_mm,y_mm,z_mm`, or with `load_step` and, if there are several nodes, `node`.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

from twin.errors import FormatError
from twin.finite_elements.nodal_result import Components, NodalResult, StepResults
from twin.formats.csv_reading import CsvRow, csv_lines, read_rows

POSITION_COLUMNS = ("x_mm", "y_mm", "z_mm")
PROBE_COLUMNS = ("probe_x", "probe_y", "probe_z")
_DISPLACEMENT = ("ux", "uy", "uz")
_ROTATION = ("rotx", "roty", "rotz")
_SEPARATOR = re.compile("[;\t]")


@dataclass(frozen=True)
class ListedPosition:
    """Axis position in mm, with the place of its result: file, load step, node, and the point of a mesh. None where the
    table does not say it."""

    axes_mm: Components
    file: str | None
    load_step: int | None
    node: int | None
    probe: Components | None
    row: int


def parse_positions_of_results(text: str, source: str) -> tuple[ListedPosition, ...]:
    """Return the axis positions of a table. Raises FormatError, which names `source`, row and column."""
    rows = read_rows(text, source, POSITION_COLUMNS, ("file", "load_step", "node", *PROBE_COLUMNS))
    listed = tuple(_position(row) for row in rows)
    if not listed:
        raise FormatError("no axis position follows the header", file=source)
    return listed


def has_positions(text: str, source: str) -> bool:
    """Return True if a CSV text with results contains the axis positions itself, even if its separators are
    wrong. Raises FormatError if it is no CSV text."""
    first = next(csv_lines(text, source), (1, []))[1]
    return any("x_mm" in map(str.strip, _SEPARATOR.split(cell)) for cell in first)


def parse_results_at_positions(text: str, source: str) -> tuple[tuple[ListedPosition, ...], StepResults]:
    """Return the axis positions and the results of a CSV text that contains both. The results are numbered as load
    steps, from 1. Raises FormatError, which names `source`, row and column."""
    positions, results = [], []
    for number, row in enumerate(read_rows(text, source, (*POSITION_COLUMNS, *_DISPLACEMENT), _ROTATION), start=1):
        axes = _triple(row, POSITION_COLUMNS)
        positions.append(ListedPosition(axes, None, number, None, None, row.number))
        results.append(NodalResult(number, 1, _triple(row, _DISPLACEMENT), _rotation(row), row.number))
    if not results:
        raise FormatError("no result follows the header", file=source)
    return tuple(positions), StepResults.collected(results, source)


def parse_results_by_step(text: str, source: str) -> StepResults:
    """Return the results of a CSV text with load steps. Raises FormatError, which names `source`, row and column."""
    results = []
    for row in read_rows(text, source, ("load_step", *_DISPLACEMENT), ("node", *_ROTATION)):
        node = row.parse_int("node", 1) if row.cells["node"] else 1
        step = row.parse_int("load_step", 0)
        results.append(NodalResult(step, node, _triple(row, _DISPLACEMENT), _rotation(row), row.number))
    if not results:
        raise FormatError("no result follows the header", file=source)
    return StepResults.collected(results, source)


def _position(row: CsvRow) -> ListedPosition:
    given = [name for name in PROBE_COLUMNS if row.cells[name]]
    return ListedPosition(
        axes_mm=_triple(row, POSITION_COLUMNS),
        file=row.cells["file"] or None,
        load_step=row.parse_int("load_step", 0) if row.cells["load_step"] else None,
        node=row.parse_int("node", 1) if row.cells["node"] else None,
        probe=_triple(row, PROBE_COLUMNS) if given else None,
        row=row.number,
    )


def _triple(row: CsvRow, columns: tuple[str, ...]) -> Components:
    x, y, z = (row.parse_float(column) for column in columns)
    return x, y, z


def _rotation(row: CsvRow) -> Components | None:
    return _triple(row, _ROTATION) if any(row.cells[name] for name in _ROTATION) else None
