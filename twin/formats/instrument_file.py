"""Instrument file (CSV): the readings of one instrument in one set-up, with a head that describes the set-up.

The head consists of the first lines, which begin with `#`; without this sign they are TOML. Each further line is one
reading. Columns x, y and z are axis positions in mm; the tool offset is not added to them.

    # instrument = "laser"
    # tool = "reflector"
    # sigma_um = 0.3
    # scale_um_per_m = 0.5
    x_mm,y_mm,z_mm,reading_um
    0,650,400,0.0
    100,650,400,0.4
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Literal

import numpy as np
from numpy.typing import ArrayLike
from pydantic import Field

from twin.arrays import Array
from twin.errors import DataError, FormatError
from twin.formats.csv_reading import CsvRow, read_rows
from twin.formats.toml_reading import StrictModel, parse_toml, validate_document
from twin.identification.instruments.kinds import (
    BallbarSetUp,
    LaserSetUp,
    Readings,
    StraightnessSetUp,
    ballbar_circle,
    laser_line,
    level_readings,
    stated_values,
    straightness_line,
)
from twin.identification.instruments.readings import INSTRUMENT_KINDS, InstrumentReadings
from twin.machine.error_model import ErrorModel, Ranges
from twin.machine.kinematic_chain import AXES
from twin.units import MICRO_UNITS, MM_PER_UM

COORDINATES = ("x_mm", "y_mm", "z_mm")
_BEYOND_MM = 1.0  # as for balls: corrections may carry an axis beyond its soft limits by less than this
_RAD_PER_URAD = 1e-6

Uncertainty = Annotated[float, Field(ge=0.0)]
Noise = Annotated[float, Field(gt=0.0)]
Triple = tuple[float, float, float]
Device = Annotated[str | None, Field(min_length=1, max_length=80)]


class _Head(StrictModel):
    tool: str | None = None
    tool_offset_mm: Triple | None = None
    device: Device = None


class _LaserHead(_Head):
    sigma_um: Noise | None = None
    scale_um_per_m: Uncertainty = LaserSetUp.scale_um_per_m
    drift_um: Uncertainty = LaserSetUp.drift_um


class _StraightnessHead(_Head):
    across: Literal["X", "Y", "Z"]
    sigma_um: Noise | None = None
    scale_percent: Uncertainty = StraightnessSetUp.scale_percent
    bow_um_per_m2: Uncertainty = StraightnessSetUp.bow_um_per_m2


class _BallbarHead(_Head):
    centre_mm: Triple
    radius_mm: Annotated[float, Field(gt=0.0)]
    plane: Literal["XY", "YZ", "ZX"]
    sigma_um: Noise | None = None
    length_um: Uncertainty = BallbarSetUp.length_um
    scale_percent: Uncertainty = BallbarSetUp.scale_percent
    form_um: Uncertainty = BallbarSetUp.form_um


class _LevelHead(StrictModel):
    about: Literal["X", "Y", "Z"]
    sigma_urad: Noise | None = None
    device: Device = None
    scale_percent: Uncertainty = 0.5


class _ValuesHead(StrictModel):
    """Head of an earlier report: each value states its own uncertainty."""


_HEADS: Mapping[str, type[StrictModel]] = {
    "laser": _LaserHead,
    "straightness": _StraightnessHead,
    "ballbar": _BallbarHead,
    "level": _LevelHead,
    "values": _ValuesHead,
}


@dataclass(frozen=True)
class InstrumentMachine:
    """Machine of an instrument file: its `tools` by name with their offsets (3,) in mm, the `travel` of its axes, and
    the error model whose parameters an earlier report may state."""

    tools: Mapping[str, ArrayLike]
    travel: Ranges
    model: ErrorModel


def parse_instrument(text: str, source: str, name: str, machine: InstrumentMachine) -> InstrumentReadings:
    """Return the readings of an instrument file given as text. `name` is how results name the instrument.

    Raises FormatError or DataError, which name `source` and the key or the row and column, if the text is invalid or if
    its values cannot be those of a measurement.
    """
    lines = text.removeprefix("\ufeff").splitlines()
    count = next((number for number, line in enumerate(lines) if not line.lstrip().startswith("#")), len(lines))
    head = _head(lines[:count], source)
    body = "\n".join(lines[count:])
    try:
        return _readings(head, body, source, name, machine, count)
    except DataError as error:
        raise error.at(file=source) from None


def _head(lines: Sequence[str], source: str) -> StrictModel:
    document = parse_toml("\n".join(line.lstrip().removeprefix("#").strip() for line in lines), source)
    kind = document.pop("instrument", None)
    if kind not in INSTRUMENT_KINDS:
        message = "key 'instrument' is missing" if kind is None else f"unknown instrument {kind!r:.80}"
        hint = f'Begin the file with a line such as: # instrument = "laser". Known: {", ".join(INSTRUMENT_KINDS)}'
        raise FormatError(message, hint=hint, file=source, key="instrument")
    return validate_document(document, source, _HEADS[kind])


def _readings(
    head: StrictModel, body: str, source: str, name: str, machine: InstrumentMachine, skipped: int
) -> InstrumentReadings:
    match head:
        case _ValuesHead():
            return _values(_rows(body, source, ("parameter", "value", "sigma"), (), skipped), name, machine.model)
        case _LevelHead():
            rows = _rows(body, source, (*COORDINATES, "reading_urad"), ("sigma_urad",), skipped)
            seen = _seen(rows, name, "urad", _RAD_PER_URAD, head.sigma_urad, np.zeros(3))
            seen = replace(seen, device=head.device)
            return level_readings(seen, _points(rows, machine), _direction(head.about), head.scale_percent)
        case _BallbarHead():
            rows = _rows(body, source, ("angle_deg", "reading_um"), ("sigma_um",), skipped)
            return _circle(head, rows, name, machine, source)
        case _LaserHead() | _StraightnessHead():
            rows = _rows(body, source, (*COORDINATES, "reading_um"), ("sigma_um",), skipped)
            seen = _seen(rows, name, "um", MM_PER_UM, head.sigma_um, _offset(head, machine, source))
            seen = replace(seen, device=head.device)
            points = _points(rows, machine)
            if isinstance(head, _LaserHead):
                return laser_line(seen, points, LaserSetUp(head.scale_um_per_m, head.drift_um))
            set_up = StraightnessSetUp(head.scale_percent, head.bow_um_per_m2)
            return straightness_line(seen, points, _direction(head.across), set_up)
    raise AssertionError(head)


def _rows(body: str, source: str, columns: Sequence[str], optional: Sequence[str], skipped: int) -> list[CsvRow]:
    """Return the rows below the head. They are numbered as the lines of the file."""
    try:
        rows = [replace(row, number=row.number + skipped) for row in read_rows(body, source, columns, optional)]
    except FormatError as error:
        if "row" in error.where:
            error.where["row"] = str(int(error.where["row"]) + skipped)
        raise
    if not rows:
        raise FormatError("no reading follows the header", file=source)
    return rows


def _seen(
    rows: Sequence[CsvRow], name: str, unit: str, factor: float, sigma: float | None, tool_offset: Array
) -> Readings:
    column = f"sigma_{unit}"
    values, noise = [], []
    for row in rows:
        values.append(factor * row.parse_float(f"reading_{unit}"))
        stated = row.parse_float(column, sigma) if sigma is not None or row.cells[column] else 0.0
        if not stated > 0.0:
            hint = f"Add the column {column} or a line such as: # {column} = 0.3"
            raise row.error("no standard uncertainty above zero is stated", column, hint)
        noise.append(factor * stated)
    return Readings(name, np.array(values), np.array(noise), tool_offset, tuple(row.number for row in rows))


def _points(rows: Sequence[CsvRow], machine: InstrumentMachine) -> Array:
    points = np.array([[row.parse_float(column) for column in COORDINATES] for row in rows])
    for axis, (low, high) in enumerate(machine.travel):
        outside = (points[:, axis] < low - _BEYOND_MM) | (points[:, axis] > high + _BEYOND_MM)
        if outside.any():
            worst = int(np.argmax(outside))
            message = f"{points[worst, axis]:g} mm lies outside the travel of {AXES[axis]}, {low:g} to {high:g} mm"
            hint = "State axis positions, without the tool offset"
            raise rows[worst].error(message, COORDINATES[axis], hint)
    return points


def _circle(
    head: _BallbarHead, rows: Sequence[CsvRow], name: str, machine: InstrumentMachine, source: str
) -> InstrumentReadings:
    seen = _seen(rows, name, "um", MM_PER_UM, head.sigma_um, _offset(head, machine, source))
    seen = replace(seen, device=head.device)
    axes = AXES.index(head.plane[0]), AXES.index(head.plane[1])
    for axis, (low, high) in enumerate(machine.travel):
        reach = head.radius_mm if axis in axes else 0.0
        middle = head.centre_mm[axis]
        if not low - _BEYOND_MM <= middle - reach <= middle + reach <= high + _BEYOND_MM:
            message = f"the circle leaves the travel of {AXES[axis]}, {low:g} to {high:g} mm"
            raise FormatError(message, hint="State the centre as an axis position", file=source, key="centre_mm")
    angles = np.radians([row.parse_float("angle_deg") for row in rows])
    set_up = BallbarSetUp(head.length_um, head.scale_percent, head.form_um)
    return ballbar_circle(seen, head.centre_mm, head.radius_mm, axes, angles, set_up)


def _values(rows: Sequence[CsvRow], name: str, model: ErrorModel) -> InstrumentReadings:
    units = {parameter.name: parameter.unit for parameter in model.parameters}
    names, values, noise = list[str](), [], []
    for row in rows:
        parameter = row.cells["parameter"]
        if parameter not in units:
            hint = (
                f"Known are {', '.join(model.names[:3])} to {model.names[-1]}; a higher order needs the option --order"
            )
            raise row.error(f"'{parameter}' is no parameter of the error model", "parameter", hint)
        if parameter in names:
            raise row.error(f"'{parameter}' is stated twice", "parameter")
        factor = MICRO_UNITS[units[parameter]][1]
        sigma = row.parse_float("sigma")
        if not sigma > 0.0:
            raise row.error("a standard uncertainty must be above zero", "sigma")
        names.append(parameter)
        values.append(row.parse_float("value") / factor)
        noise.append(sigma / factor)
    lines = tuple(row.number for row in rows)
    used = tuple(units[parameter] for parameter in names)
    return stated_values(name, tuple(names), used, np.array(values), np.array(noise), lines)


def _offset(head: _Head, machine: InstrumentMachine, source: str) -> Array:
    if head.tool_offset_mm is not None:
        if head.tool is not None:
            hint = "remove one of the two lines"
            message = "tool and tool_offset_mm both say where the reflector or ball is"
            raise FormatError(message, hint=hint, file=source, key="tool")
        return np.array(head.tool_offset_mm)
    known = ", ".join(machine.tools)
    if head.tool is None:
        hint = f'Add a line such as: # tool = "NAME" (known: {known}) or: # tool_offset_mm = [0, 0, -150]'
        raise FormatError("neither tool nor tool_offset_mm says where the reflector or ball is", hint=hint, file=source)
    if head.tool not in machine.tools:
        raise FormatError(f"the machine has no tool '{head.tool}'", hint=f"Known: {known}", file=source, key="tool")
    return np.asarray(machine.tools[head.tool], dtype=np.float64)


def _direction(axis: str) -> Array:
    return np.asarray(np.eye(3)[AXES.index(axis)])
