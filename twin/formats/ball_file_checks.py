"""Checks of a ball file for values that no measurement can have given: axis positions outside the travel, and the same
measurement given twice."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from twin.arrays import Array
from twin.errors import FormatError
from twin.formats.csv_reading import CsvRow
from twin.machine.error_model import Ranges
from twin.machine.kinematic_chain import AXES

COORDINATES = ("x_mm", "y_mm", "z_mm")
_BEYOND_MM = 1.0  # corrections of a table may carry an axis position beyond the soft limits, by less than this
_UM_FOR_MM = 20.0  # values this many times the travel are no shifted frame
_SAME_DECIMALS = 6
_MIN_REPEATED = 3  # of a bar measured twice with a resolution of 1 µm, single balls agree by chance


def check_travel(rows: Sequence[CsvRow], axis_positions: Array, tool_offsets: Array, travel: Ranges) -> None:
    """Raise FormatError, which names the first row and column, if axis positions (n, 3) in mm lie outside the travel.

    `tool_offsets` (n, 3) in mm are the offsets of the tools of the rows. `travel` contains the travel limits of X, Y
    and Z in mm. The hint states which mistake would explain the values of all rows.
    """
    low, high = np.array(travel).T
    outside = _outside(axis_positions, low, high)
    if not outside.any():
        return
    row = int(outside.any(axis=1).argmax())
    axis = int(outside[row].argmax())
    count = int(outside.any(axis=1).sum())
    value, limits = axis_positions[row, axis], f"{low[axis]:g} to {high[axis]:g} mm"
    message = f"{value:.10g} mm lies outside the travel of {AXES[axis]}, {limits}"
    if count > 1:
        message += f", as do {count} of {len(rows)} rows"
    raise rows[row].error(message, COORDINATES[axis], _remedy(axis_positions, tool_offsets, low, high))


def _outside(points: Array, low: Array, high: Array) -> np.ndarray[tuple[int, ...], np.dtype[np.bool_]]:
    return np.asarray((points < low - _BEYOND_MM) | (points > high + _BEYOND_MM))


def _remedy(points: Array, tool_offsets: Array, low: Array, high: Array) -> str:
    """Return the hint that explains why `points` (n, 3) in mm leave the travel from `low` to `high`."""

    def explained(changed: Array) -> bool:
        return not _outside(changed, low, high).any()

    if np.abs(points).max() > _UM_FOR_MM * (high - low).max() and explained(1e-3 * points):
        return "All rows lie inside if the values are µm: give mm"
    if explained(points - tool_offsets):
        return "All rows lie inside less the tool offset: give axis positions without the tool offset"
    for axis, name in enumerate(AXES):
        mirrored = np.where(np.arange(3) == axis, -1.0, 1.0)
        if explained(points * mirrored):
            return f"All rows lie inside with the other sign of {name}: give the positions that the machine displays"
    if (np.ptp(points, axis=0) <= high - low).all():
        return "The frame is shifted: give machine coordinates without work offset, or correct travel_mm of the machine"
    return "Check the units of the values and travel_mm of the machine file"


def check_repeated(
    rows: Sequence[CsvRow], numbers: Sequence[int], tools: Sequence[int], balls: Sequence[int], axis_positions: Array
) -> None:
    """Raise FormatError if the same measurement is given twice.

    Two balls of one position cannot have the same coordinates to the last digit. If several balls of two positions
    (at least half of the balls of one of them) share their coordinates, one measurement is in the file under two
    position numbers (`numbers`), and the identification would count it twice.
    """
    first_at: dict[tuple[object, ...], int] = {}
    repeated: dict[tuple[int, int], list[tuple[int, int]]] = {}
    places = np.round(axis_positions, _SAME_DECIMALS)
    for row, (tool, place) in enumerate(zip(tools, map(tuple, places.tolist()), strict=True)):
        first = first_at.setdefault((tool, place), row)
        if first == row:
            continue
        if numbers[first] == numbers[row]:
            message = f"ball {balls[row]} has the coordinates of ball {balls[first]} in row {rows[first].number}"
            hint = "Two balls are never at the same place"
            raise rows[row].error(f"position {numbers[row]}: {message}", "ball", hint)
        repeated.setdefault((numbers[first], numbers[row]), []).append((first, row))
    for (one, other), pairs in repeated.items():
        smaller = min(numbers.count(one), numbers.count(other))
        if len(pairs) >= min(_MIN_REPEATED, smaller) and 2 * len(pairs) >= smaller:
            raise _repeated(rows, one, other, pairs)


def _repeated(rows: Sequence[CsvRow], one: int, other: int, pairs: Sequence[tuple[int, int]]) -> FormatError:
    first, row = pairs[0]
    message = f"position {other} repeats position {one}: {len(pairs)} balls have the same coordinates"
    return rows[row].error(
        f"{message}, beginning with row {rows[first].number} and row {rows[row].number}",
        "position",
        "Give each measurement once; a bar that was measured again has different coordinates",
    )
