"""Feature file (CSV): each line contains one feature of a workpiece, in the coordinates of the drawing.

Every line has the columns `name`, `kind`, `x_mm`, `y_mm` and `z_mm`. What the other columns mean depends on the kind:

========  =====================  ===================================  ====================================
kind      x_mm, y_mm, z_mm       further columns                      error
========  =====================  ===================================  ====================================
datum     point                                                       sets the coordinates of the workpiece
point     point of a surface     i, j, k: its normal                  displacement along the normal
distance  first point            to_x_mm, to_y_mm, to_z_mm: second    too long is positive
diameter  centre                 size_mm; i, j, k: axis               too large is positive
position  centre of a hole       i, j, k: axis                        diameter of the zone (ISO 1101)
flatness  centre of a face       size_mm, width_mm; i, j, k: normal   largest minus smallest (ISO 1101)
========  =====================  ===================================  ====================================

`i`, `j`, `k` are 0, 0, 1 if all three are empty. `lower_um` and `upper_um` are the limits of the error; a line without
them has no tolerance. A position and a flatness have only an upper limit.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence

import numpy as np

from twin.arrays import Array
from twin.errors import DataError, FormatError
from twin.formats.csv_reading import CsvRow, read_rows
from twin.units import MM_PER_UM
from twin.workpiece import features as make
from twin.workpiece.features import Feature, FeatureKind, Tolerance

COLUMNS = ("name", "kind", "x_mm", "y_mm", "z_mm")
_SECOND = ("to_x_mm", "to_y_mm", "to_z_mm")
_DIRECTION = ("i", "j", "k")
_SIZES = ("size_mm", "width_mm")
_LIMITS = ("lower_um", "upper_um")
OPTIONAL_COLUMNS = (*_SECOND, *_DIRECTION, *_SIZES, *_LIMITS)
MOST_FEATURES = 2000
_LARGEST_MM = 1e5
_LONGEST_NAME = 100
_USED = {
    FeatureKind.DATUM: (),
    FeatureKind.POINT: (*_DIRECTION, *_LIMITS),
    FeatureKind.DISTANCE: (*_SECOND, *_LIMITS),
    FeatureKind.DIAMETER: (*_DIRECTION, "size_mm", *_LIMITS),
    FeatureKind.POSITION: (*_DIRECTION, "upper_um"),
    FeatureKind.FLATNESS: (*_DIRECTION, *_SIZES, "upper_um"),
}
"""Optional columns that a line of each kind may fill."""


def parse_features(text: str, source: str) -> tuple[Feature, ...]:
    """Return the features of a feature file with the text `text`, in the order of the lines.

    `source` is the name of the file for error messages. Raises FormatError, which names file, row and column, if the
    text is invalid, if a name is given twice or if there is no feature.
    """
    found = tuple(_distinct(read_rows(text, source, COLUMNS, OPTIONAL_COLUMNS), source))
    if all(feature.kind is FeatureKind.DATUM for feature in found):
        kinds = _kinds(kind for kind in _USED if kind is not FeatureKind.DATUM)
        hint = f"Give at least one line of the kind {kinds}"
        raise FormatError("the file contains no feature to predict", hint=hint, file=source)
    return found


def _distinct(rows: Iterator[CsvRow], source: str) -> Iterator[Feature]:
    seen: dict[str, int] = {}
    for row in rows:
        if len(seen) == MOST_FEATURES:
            raise FormatError(f"the file has more than {MOST_FEATURES} features", hint="Split it", file=source)
        feature = _feature(row)
        if feature.name in seen:
            raise row.error(f"'{feature.name}' is already the name of row {seen[feature.name]}", "name")
        seen[feature.name] = row.number
        yield feature


def _feature(row: CsvRow) -> Feature:
    name, kind = row.cells["name"], _kind(row)
    if not name:
        raise row.error("the cell is empty", "name", "Give each feature a name")
    if not name.isprintable() or len(name) > _LONGEST_NAME:
        raise row.error(f"a name has at most {_LONGEST_NAME} printable characters", "name")
    for column in OPTIONAL_COLUMNS:
        if row.cells[column] and column not in _USED[kind]:
            used = ", ".join(_USED[kind]) or "no further columns"
            raise row.error(f"a {kind} has no {column}", column, f"A {kind} uses {used}")
    at = _numbers(row, COLUMNS[2:])
    try:
        return _made(row, name, kind, at)
    except DataError as error:
        raise FormatError(error.message, hint=error.hint, file=row.source, row=row.number) from None


def _made(row: CsvRow, name: str, kind: FeatureKind, at: Array) -> Feature:
    tolerance = _tolerance(row)
    match kind:
        case FeatureKind.DATUM:
            return make.datum(name, at)
        case FeatureKind.POINT:
            return make.point(name, at, _direction(row), tolerance)
        case FeatureKind.DISTANCE:
            return make.distance(name, at, _numbers(row, _SECOND), tolerance)
        case FeatureKind.DIAMETER:
            return make.diameter(name, at, _direction(row), _number(row, "size_mm"), tolerance)
        case FeatureKind.POSITION:
            return make.position(name, at, _direction(row), tolerance)
        case FeatureKind.FLATNESS:
            sides = _number(row, "size_mm"), _number(row, "width_mm")
            return make.flatness(name, at, _direction(row), sides, tolerance)
        case _:
            raise row.error(f"'{kind}' is no kind of feature", "kind")


def _kind(row: CsvRow) -> FeatureKind:
    text = row.cells["kind"].lower()
    kind = next((kind for kind in _USED if kind == text), None)
    if kind is None:
        raise row.error(f"'{text}' is no kind of feature", "kind", f"Write {_kinds(_USED)}")
    return kind


def _kinds(kinds: Iterable[FeatureKind]) -> str:
    *others, last = kinds
    return f"{', '.join(others)} or {last}"


def _direction(row: CsvRow) -> Array:
    if not any(row.cells[column] for column in _DIRECTION):
        return np.array([0.0, 0.0, 1.0])
    return np.array([row.parse_float(column, empty=0.0) for column in _DIRECTION])


def _numbers(row: CsvRow, columns: Sequence[str]) -> Array:
    return np.array([_number(row, column) for column in columns])


def _number(row: CsvRow, column: str) -> float:
    value = row.parse_float(column)
    if abs(value) > _LARGEST_MM:
        raise row.error(f"{value:g} mm is no size of a workpiece on a machine tool", column, "Write mm")
    return value


def _tolerance(row: CsvRow) -> Tolerance | None:
    lower, upper = (MM_PER_UM * row.parse_float(column) if row.cells[column] else None for column in _LIMITS)
    return None if lower is None and upper is None else Tolerance(lower, upper)
