"""Conversion of CSV text to rows of named cells. Errors name the file, the row (the header is row 1) and the column."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from twin.errors import FormatError

_LARGEST_INT = 2**31 - 1
"""Largest whole number in a cell. Those of files are numbers of positions, balls and nodes."""


@dataclass(frozen=True)
class CsvRow:
    """One row of a CSV file. `number` is its line number in the file; `cells` contains the text of each cell by column
    name."""

    source: str
    number: int
    cells: dict[str, str]

    def error(self, message: str, column: str, hint: str = "") -> FormatError:
        return FormatError(message, hint=hint, file=self.source, row=self.number, column=column)

    def parse_float(self, column: str, empty: float | None = None) -> float:
        """Return the finite number in a cell. If the cell is empty and a default `empty` is given, return `empty`."""
        text = self.cells[column]
        if not text and empty is not None:
            return empty
        try:
            value = float(text)
        except ValueError:
            raise self.error(f"'{text}' is not a number" if text else "the cell is empty", column) from None
        if not math.isfinite(value):
            raise self.error(f"'{text}' is not finite", column)
        return value

    def parse_int(self, column: str, at_least: int) -> int:
        text = self.cells[column]
        try:
            value = int(text)
        except ValueError:
            raise self.error(f"'{text}' is not a whole number", column) from None
        if value < at_least:
            raise self.error(f"{value} is less than {at_least}", column)
        if value > _LARGEST_INT:
            raise self.error(f"'{text}' is larger than {_LARGEST_INT}", column)
        return value


def csv_lines(text: str, source: str) -> Iterator[tuple[int, list[str]]]:
    """Yield the cells of every row of a CSV text with the number of its last line. Raise FormatError if a row cannot be
    split into cells, for example because one cell is longer than 131072 characters."""
    lines = csv.reader(io.StringIO(text.removeprefix("\ufeff"), newline=""))
    try:
        for cells in lines:
            yield lines.line_num, cells
    except csv.Error as error:
        hint = "Check the quotation marks: one that is not closed joins all lines that follow"
        raise FormatError(f"this is not valid CSV: {error}", hint=hint, file=source, row=lines.line_num) from None


def read_rows(text: str, source: str, columns: Sequence[str], optional: Sequence[str] = ()) -> Iterator[CsvRow]:
    """Yield the rows of a CSV text. The header must contain the names in `columns` and may contain those in `optional`,
    in any order. The cells of an optional column that is missing are empty. Blank lines are skipped."""
    lines = csv_lines(text, source)
    header = [name.strip() for name in next(lines, (1, []))[1]]
    _check_header(header, source, columns, optional)
    for number, cells in lines:
        if not any(cell.strip() for cell in cells):
            continue
        if len(cells) != len(header):
            message = f"{len(cells)} values, but the header names {len(header)} columns"
            raise FormatError(message, file=source, row=number)
        named = {name: cell.strip() for name, cell in zip(header, cells, strict=True)}
        yield CsvRow(source, number, {**dict.fromkeys(optional, ""), **named})


def _check_header(header: list[str], source: str, columns: Sequence[str], optional: Sequence[str]) -> None:
    hint = f"The first line must be {','.join(columns)}"
    if optional:
        hint += f", and may go on with {','.join(optional)}"
    if len(header) == 1 and len(columns) > 1:
        for separator, shown in ((";", ";"), ("\t", "\\t")):
            if separator in header[0]:
                message = f"the columns are separated by '{shown}', not by commas"
                raise FormatError(message, hint=hint, file=source, row=1)
    for name in columns:
        if header.count(name) != 1:
            problem = "is missing" if name not in header else "appears more than once"
            raise FormatError(f"column '{name}' {problem}", hint=hint, file=source, row=1, column=name)
    for name in header:
        if name not in columns and (name not in optional or header.count(name) > 1):
            problem = "appears more than once" if name in optional else "is not known"
            raise FormatError(f"column '{name}' {problem}", hint=hint, file=source, row=1, column=name)
