"""Position set file (CSV or TOML): list of artefact positions with `station`, `azimuth_deg` and `elevation_deg` of each
position, in measuring order.

A column `tool` is needed if several tools are used. An empty cell in this column means the tool named in the settings
of the run. A column `balls` lists the numbers of the balls that are measured, counted from 0 and separated by spaces;
an empty cell means all balls within reach. Lines of a CSV file that begin with ``#`` are comments.
"""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Iterable

from twin.artefact.position_set import Position
from twin.errors import DataError, FormatError
from twin.formats.csv_reading import csv_lines
from twin.formats.toml_reading import StrictModel, read_toml

COLUMNS = ("station", "azimuth_deg", "elevation_deg")
TOOL, BALLS = "tool", "balls"
_LONGEST_NUMBER = 6
_OPTIONAL = (TOOL, BALLS)


class _PositionRow(StrictModel):
    station: int
    azimuth_deg: float
    elevation_deg: float
    tool: str | None = None
    balls: tuple[int, ...] | None = None


class _PositionDocument(StrictModel):
    positions: list[_PositionRow]


def parse_positions(text: str, source: str) -> tuple[Position, ...]:
    """Return the positions given as CSV text, or as TOML text (``[[positions]]``) if `source` ends in ``.toml``.

    Raise FormatError if the text is invalid. For TOML text the error names `source` and the key; for CSV text it names
    `source`, the row (the header is row 1) and the column.
    """
    listed = _from_toml(text, source) if source.endswith(".toml") else _from_csv(text, source)
    _check_listed(listed, source)
    return tuple(position for _, position in listed)


def _from_toml(text: str, source: str) -> list[tuple[int, Position]]:
    positions = []
    for index, listed in enumerate(read_toml(text, source, _PositionDocument).positions):
        try:
            positions.append((index + 2, Position(**listed.model_dump())))
        except DataError as error:
            raise FormatError(error.message, hint=error.hint, file=source, key=f"positions[{index}]") from None
    return positions


def _from_csv(text: str, source: str) -> list[tuple[int, Position]]:
    """Return the row number and the position of every line. Comments count as rows."""
    rows = enumerate((cells for _, cells in csv_lines(text, source)), start=1)
    first, *lines = [(row, cells) for row, cells in rows if not _is_comment(cells)] or [(1, [])]
    header = [name.strip() for name in first[1]]
    required = [name for name in header if name not in _OPTIONAL]
    if sorted(required) != sorted(COLUMNS) or len(set(header)) < len(header):
        hint = (
            f"The first line after comments must be {','.join(COLUMNS)}, with {TOOL} if several tools are used and "
            f"{BALLS} if not all balls are measured"
        )
        raise FormatError(f"columns are {','.join(header) or 'missing'}", hint=hint, file=source, row=first[0])
    return [
        (row, _position(_named(cells, header, source, row), source, row))
        for row, cells in lines
        if any(cell.strip() for cell in cells)
    ]


def _named(cells: list[str], header: list[str], source: str, row: int) -> dict[str, str]:
    """Return the cells of a row by the names of their columns. Optional columns may be missing at the end.

    Raise FormatError if there are more cells than columns, as decimal commas make them: the first ones would be read as
    other numbers.
    """
    if any(cell.strip() for cell in cells[len(header) :]):
        message = f"{len(cells)} values, but the header names {len(header)} columns"
        hint = "Write decimal points, and separate the numbers of balls by spaces"
        raise FormatError(message, hint=hint, file=source, row=row)
    return dict(zip(header, cells, strict=False))


def _is_comment(cells: list[str]) -> bool:
    return bool(cells) and cells[0].lstrip().startswith("#")


def format_positions(positions: Iterable[Position], comment: str = "") -> str:
    """Return `positions` as CSV text that `parse_positions` reads. If `comment` is given, it is the first line."""
    listed = list(positions)
    used = {TOOL: any(p.tool for p in listed), BALLS: any(p.balls for p in listed)}
    columns = (*COLUMNS, *(name for name in _OPTIONAL if used[name]))
    text = io.StringIO()
    text.write(f"# {' '.join(comment.split())}\n" if comment else "")
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(columns)
    for p in listed:
        optional = {TOOL: p.tool or "", BALLS: " ".join(map(str, p.balls or ()))}
        cells = (p.station, f"{p.azimuth_deg:.10g}", f"{p.elevation_deg:.10g}")
        writer.writerow((*cells, *(optional[name] for name in columns[len(cells) :])))
    return text.getvalue()


def _position(cells: dict[str, str], source: str, row: int) -> Position:
    station = _number(cells, "station", source, row)
    if station != int(station):
        raise FormatError(f"station {station} is not a whole number", file=source, row=row, column="station")
    azimuth, elevation = (_number(cells, name, source, row) for name in COLUMNS[1:])
    try:
        tool, balls = cells.get(TOOL, "").strip() or None, _balls(cells, source, row)
        return Position(int(station), azimuth, elevation, tool, balls)
    except DataError as error:
        raise FormatError(error.message, hint=error.hint, file=source, row=row) from None


def _balls(cells: dict[str, str], source: str, row: int) -> tuple[int, ...] | None:
    listed = cells.get(BALLS, "").split()
    if not all(ball.isascii() and ball.isdecimal() and len(ball) <= _LONGEST_NUMBER for ball in listed):
        text = " ".join(listed)[:40]
        raise FormatError(f"'{text}' are not numbers of balls", file=source, row=row, column=BALLS)
    return tuple(map(int, listed)) or None


def _number(cells: dict[str, str], column: str, source: str, row: int) -> float:
    text = cells.get(column, "").strip()
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise FormatError(f"'{text}' is not a finite number", file=source, row=row, column=column)
    return value


def _check_listed(listed: list[tuple[int, Position]], source: str) -> None:
    if not listed:
        raise FormatError("no position is listed", hint="Write one line per position", file=source)
    seen: dict[Position, int] = {}
    for number, (row, position) in enumerate(listed, start=1):
        if position in seen:
            raise FormatError(f"this position is already listed as number {seen[position]}", file=source, row=row)
        seen[position] = number
