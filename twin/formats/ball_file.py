"""Ball file (CSV): each line contains one measured ball centre.

The columns x, y and z are axis positions; the tool offset is not added to them. Values that no measurement
can have given are refused: axis positions outside the travel, and the same measurement given twice.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import ArrayLike

from twin.arrays import Array
from twin.artefact.observations import Observations
from twin.artefact.position_set import Position
from twin.display import Displayed
from twin.errors import FormatError, PositionError, TwinError
from twin.formats.csv_reading import CsvRow, read_rows
from twin.machine.error_model import Ranges
from twin.machine.kinematic_chain import AXES

COORDINATES = ("x_mm", "y_mm", "z_mm")
_BEYOND_MM = 1.0  # corrections of a table may carry an axis position beyond the soft limits, by less than this
_UM_FOR_MM = 20.0  # values this many times the travel are no shifted frame
_SAME_MM = 2e-5  # far below the repeatability of any probe on a machine tool
_MIN_REPEATED = 3  # of a bar measured twice with a resolution of 1 µm, single balls agree by chance
COLUMNS = (
    "position",
    "station",
    "azimuth_deg",
    "elevation_deg",
    "tool",
    "ball",
    "x_mm",
    "y_mm",
    "z_mm",
    "sigma_um",
    "temperature_c",
)
DEFAULT_SIGMA_UM = 1.0
DEFAULT_TEMPERATURE_C = 20.0
"""Reference temperature of ISO 1."""
SIGMA_UM = (0.02, 50.0)
"""Smallest and largest standard uncertainty of a ball centre that a touch probe on a machine tool can have."""


@dataclass(frozen=True, eq=False)
class BallFile(Displayed):
    """Contents of a ball file: the measured ball centres and the positions in which they were measured.

    `observations` contains one ball centre for each row, in the order of the file. `positions` contains the station and
    the orientation of each of the K positions, sorted by the position number in the file. For each ball centre,
    `observations.position` is the index of its position in `positions`, from 0 to K-1. `temperature_was_read` is False
    if the file contains no temperature; each ball centre then has the reference temperature. `numbers` contains the
    number of each position in the file, and `rows` the row of each ball centre (the header is row 1). Both are empty if
    the ball centres were not read from a file.
    """

    observations: Observations
    positions: tuple[Position, ...]
    temperature_was_read: bool = True
    numbers: tuple[int, ...] = ()
    rows: tuple[int, ...] = ()

    def __repr__(self) -> str:
        return f"<BallFile: {self.observations.size} ball centres in {len(self.positions)} positions>"

    @contextmanager
    def places_named(self) -> Iterator[None]:
        """Name positions and rows of errors raised in the `with` block as the file numbers them."""
        try:
            yield
        except TwinError as error:
            raise self._renumbered(error) from None

    def as_numbered(self, balls: Iterable[tuple[int, int, int]]) -> tuple[tuple[int, int, int], ...]:
        """Return balls, each given by the index of its position, its ball number and the index of its tool, with the
        position number in the file instead of the index."""
        named = self.numbers or range(len(self.positions))
        return tuple((named[position], ball, tool) for position, ball, tool in balls)

    def _renumbered(self, error: TwinError) -> TwinError:
        if self.numbers and isinstance(error, PositionError):
            error = error.renumbered(self.numbers[error.position])
        if self.rows and "row" in error.where:
            error.where["row"] = str(self.rows[int(error.where["row"])])
        return error


def parse_balls(
    text: str,
    source: str,
    tools: Mapping[str, ArrayLike],
    default_sigma_um: float = DEFAULT_SIGMA_UM,
    default_temperature_c: float = DEFAULT_TEMPERATURE_C,
    travel: Ranges | None = None,
) -> BallFile:
    """Return the contents of a ball file given as CSV text.

    `tools` maps the names of the machine's tools to their offsets (3,) in mm. If the cell of a standard uncertainty or
    a temperature is empty in a row, `default_sigma_um` or `default_temperature_c` is used. The temperature must be
    given for all ball centres or for none. `travel` contains the travel limits of X, Y and Z in mm; axis positions are
    not compared with them if it is None. Raise FormatError, which names `source`, the row and the column, if the text
    is invalid or if its values cannot be those of a measurement.
    """
    rows = list(read_rows(text, source, COLUMNS))
    if not rows:
        raise FormatError("no ball follows the header", file=source)
    names = list(tools)
    numbers = [row.parse_int("position", 0) for row in rows]
    tool = [_tool(row, names) for row in rows]
    ball = [row.parse_int("ball", 0) for row in rows]
    _check_duplicates(rows, numbers, tool, ball)
    temperature_was_read = _temperature_was_read(rows)
    positions = _positions(rows, numbers)
    index_of = {number: index for index, number in enumerate(positions)}
    sigma_mm = np.array([1e-3 * _sigma_um(row, default_sigma_um) for row in rows])
    elevations = [positions[number].elevation_deg for number in numbers]
    axis_positions = np.array([[row.parse_float(name) for name in COORDINATES] for row in rows])
    tool_offsets = np.array([tools[name] for name in names], dtype=np.float64)
    if travel is not None:
        check_travel(rows, axis_positions, tool_offsets[tool], travel)
    check_repeated(rows, numbers, tool, ball, axis_positions)
    observations = Observations(
        position=np.array([index_of[number] for number in numbers]),
        ball=np.array(ball),
        tool=np.array(tool),
        axis_positions=axis_positions,
        covariance=sigma_mm[:, None, None] ** 2 * np.eye(3),
        temperature_c=np.array([row.parse_float("temperature_c", default_temperature_c) for row in rows]),
        elevation_rad=np.radians(elevations),
        azimuth_rad=np.radians([positions[number].azimuth_deg for number in numbers]),
        tool_offsets=tool_offsets,
    )
    lines = tuple(row.number for row in rows)
    return BallFile(observations, tuple(positions.values()), temperature_was_read, tuple(positions), lines)


def format_balls(
    observations: Observations,
    positions: Sequence[Position],
    tool_names: Sequence[str],
    temperature_was_read: bool = True,
) -> str:
    """Return the text of a ball file in CSV format.

    For each ball centre, `observations.position` is an index into `positions`, and `observations.tool` is an index into
    `tool_names`. The covariance of a ball centre is written as one standard deviation, the root of the mean variance of
    its three coordinates. If `temperature_was_read` is False, no temperature is written.
    """
    lines = [",".join(COLUMNS)]
    sigma_um = 1e3 * np.sqrt(observations.coordinate_variances_mm2)
    for row in range(observations.size):
        placement = positions[int(observations.position[row])]
        angles = f"{placement.azimuth_deg:.10g},{placement.elevation_deg:.10g}"
        head = f"{observations.position[row]},{placement.station},{angles}"
        x, y, z = observations.axis_positions[row].tolist()
        temperature = f"{observations.temperature_c[row]:.10g}" if temperature_was_read else ""
        measured = f"{x:.7f},{y:.7f},{z:.7f},{sigma_um[row]:.6g},{temperature}"
        lines.append(f"{head},{tool_names[int(observations.tool[row])]},{observations.ball[row]},{measured}")
    return "\n".join(lines) + "\n"


def _tool(row: CsvRow, names: list[str]) -> int:
    name = row.cells["tool"]
    if name not in names:
        raise row.error(f"unknown tool '{name}'", "tool", hint=f"Tools of the machine file: {', '.join(names)}")
    return names.index(name)


def _sigma_um(row: CsvRow, empty: float) -> float:
    sigma = row.parse_float("sigma_um", empty)
    if not sigma > 0.0:
        raise row.error(f"a standard uncertainty must be positive, not {sigma:g}", "sigma_um")
    low, high = SIGMA_UM
    if not low <= sigma <= high:
        hint = "The column is in µm: the values look like mm" if sigma < low else "The column is in µm"
        message = f"a touch probe does not measure ball centres to {sigma:g} µm; {low:g} to {high:g} µm is possible"
        raise row.error(message, "sigma_um", f"{hint}. Leave the cell empty if the uncertainty is not known")
    return sigma


def _temperature_was_read(rows: list[CsvRow]) -> bool:
    """Return False if the temperature of every row is empty. Raise FormatError if it is empty in some rows only: a
    temperature that was not read has a different uncertainty from one that was."""
    read = [row for row in rows if row.cells["temperature_c"]]
    if 0 < len(read) < len(rows):
        empty = next(row for row in rows if not row.cells["temperature_c"])
        message = (
            f"the temperature of position {empty.cells['position']} is empty, while row {read[0].number} gives one"
        )
        raise empty.error(message, "temperature_c", hint="Enter a temperature for every ball, or for none")
    return bool(read)


def _check_duplicates(rows: list[CsvRow], numbers: list[int], tool: list[int], ball: list[int]) -> None:
    seen: dict[tuple[int, int, int], int] = {}
    for row, key in zip(rows, zip(numbers, tool, ball, strict=True), strict=True):
        first = seen.setdefault(key, row.number)
        if first != row.number:
            message = f"ball {key[2]} of position {key[0]} was already given in row {first}"
            raise row.error(message, "ball", hint="Give one centre per position, tool and ball")


def _positions(rows: list[CsvRow], numbers: list[int]) -> dict[int, Position]:
    """Return the positions by their number in the file. Raise FormatError if rows of the same position have different
    stations or angles."""
    found: dict[int, tuple[CsvRow, Position]] = {}
    for row, number in zip(rows, numbers, strict=True):
        position = _position(row)
        first, stated = found.setdefault(number, (row, position))
        for column in ("station", "azimuth_deg", "elevation_deg"):
            if not math.isclose(getattr(position, column), getattr(stated, column), abs_tol=1e-9):
                message = f"{column} of position {number} differs from that in row {first.number}"
                raise row.error(message, column, hint="A position is one placement of the artefact")
    return {number: found[number][1] for number in sorted(found)}


def _position(row: CsvRow) -> Position:
    station = row.parse_int("station", 1)
    try:
        return Position(station, row.parse_float("azimuth_deg"), row.parse_float("elevation_deg"))
    except FormatError:
        raise
    except TwinError as error:
        raise row.error(error.message, "azimuth_deg", hint=error.hint) from None


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

    Two balls of one position cannot have the same coordinates. Coordinates count as the same if they differ by less
    than any touch probe repeats, because a copy may have been rounded or disturbed. If several balls of two positions
    (at least half of the balls of one of them) share their coordinates, one measurement is in the file under two
    position numbers (`numbers`), and the identification would count it twice.
    """
    repeated: dict[tuple[int, int], list[tuple[int, int]]] = {}
    for first, row in _copied_rows(tools, axis_positions):
        if numbers[first] == numbers[row]:
            message = f"ball {balls[row]} has the coordinates of ball {balls[first]} in row {rows[first].number}"
            raise rows[row].error(
                f"position {numbers[row]}: {message}", "ball", "Two balls are never at the same place"
            )
        repeated.setdefault((numbers[first], numbers[row]), []).append((first, row))
    for (one, other), pairs in repeated.items():
        smaller = min(numbers.count(one), numbers.count(other))
        if len(pairs) >= min(_MIN_REPEATED, smaller) and 2 * len(pairs) >= smaller:
            raise _repeated(rows, one, other, pairs)


def _copied_rows(tools: Sequence[int], axis_positions: Array) -> list[tuple[int, int]]:
    """Return the pairs of rows, the earlier one first, whose balls were touched with the same tool at the same axis
    positions (n, 3). The later rows are in their order."""
    pairs: set[tuple[int, int]] = set()
    # Two places within half a cell share a cell of at least one of two grids per axis, half a cell apart.
    for offset in product((0.0, 0.5), repeat=3):
        cells = np.floor(axis_positions / (2.0 * _SAME_MM) + np.array(offset)).tolist()
        first_at: dict[tuple[object, ...], int] = {}
        for row, (tool, cell) in enumerate(zip(tools, cells, strict=True)):
            first = first_at.setdefault((tool, *cell), row)
            if first != row:
                pairs.add((first, row))
    return sorted(pairs, key=lambda pair: pair[::-1])


def _repeated(rows: Sequence[CsvRow], one: int, other: int, pairs: Sequence[tuple[int, int]]) -> FormatError:
    first, row = pairs[0]
    message = f"position {other} repeats position {one}: {len(pairs)} balls have the same coordinates"
    return rows[row].error(
        f"{message}, beginning with row {rows[first].number} and row {rows[row].number}",
        "position",
        "Give each measurement once; a bar that was measured again has different coordinates",
    )
