"""ANSYS listing of nodal displacements and rotations, as PRNSOL prints it.

    PRINT U    NODAL SOLUTION PER NODE
      ***** POST1 NODAL DEGREE OF FREEDOM LISTING *****
      LOAD STEP=     1  SUBSTEP=     1
       TIME=    1.0000      LOAD CASE=   0
      THE FOLLOWING DEGREE OF FREEDOM RESULTS ARE IN THE GLOBAL COORDINATE SYSTEM
        NODE       UX           UY           UZ           USUM
           1  0.10751E-003 0.20751E-003-0.30751E-003 0.38000E-003

A file may contain many load steps, pages whose heading is repeated, one listing for each component, and the rotations
ROTX, ROTY, ROTZ in listings of their own. Negative numbers may follow the number before without a blank.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from dataclasses import dataclass, field

from twin.errors import FormatError
from twin.finite_elements.nodal_result import NodalResult, StepResults

DISPLACEMENTS = ("UX", "UY", "UZ")
ROTATIONS = ("ROTX", "ROTY", "ROTZ")
HEADING = "NODAL DEGREE OF FREEDOM LISTING"
_KNOWN = {*DISPLACEMENTS, "USUM", *ROTATIONS, "RSUM", "TEMP"}
_NUMBER = re.compile(
    r"\s*(?:(?<=\s)|(?=[-+]))([-+]?(?:\d+\.\d*|\.\d+|\d+)(?:[EeDd][-+]?\d{2,3})?)(?=[\s+-]|$)", re.ASCII
)
"""A number begins after a blank or with its sign: without both, where it begins would be a guess."""
_ROW = re.compile(r"\s*(\d{1,10})(?=[\s+-])(.*)", re.ASCII)
_STEP = re.compile(r"LOAD STEP\s*=\s*(\d{1,9})\s+SUBSTEP\s*=\s*(\d{1,9})", re.ASCII)
_FRAME = re.compile(r"RESULTS ARE IN\b(.*)")
_GLOBAL = "THE GLOBAL COORDINATE SYSTEM"


@dataclass
class _Node:
    """Components of one node in one load step that were read so far, and the row of the first."""

    row: int
    components: dict[str, float] = field(default_factory=dict)


@dataclass
class _Place:
    """Load step, substep and columns at the present line."""

    load_step: int = 1
    substep: int = 1
    columns: tuple[str, ...] = ()


def is_listing(text: str) -> bool:
    """Return True if a text looks like a listing of PRNSOL."""
    return HEADING in text or any(_columns(line) for line in text.splitlines()[:200])


def parse_listing(text: str, source: str) -> StepResults:
    """Return the nodal results of a PRNSOL listing, in the unit of the listing and in the global frame of the model.

    Raises FormatError, which names the file and the line, if a number cannot be read, a component is missing or given
    twice, a load step has several substeps, or the results are in another than the global frame.
    """
    found: dict[tuple[int, int], _Node] = {}
    substeps: dict[int, int] = {}
    for place, row, line in _rows(text, source):
        former = substeps.setdefault(place.load_step, place.substep)
        if former != place.substep:
            message = f"load step {place.load_step} has the substeps {former} and {place.substep}"
            raise FormatError(message, hint="List the last substep alone (SET,n,LAST)", file=source, row=row)
        node, values = _values(line, place.columns, source, row)
        known = found.setdefault((place.load_step, node), _Node(row))
        for name, value in values.items():
            if name in known.components:
                message = f"{name} of node {node} in load step {place.load_step} is listed a second time"
                raise FormatError(message, file=source, row=row)
            known.components[name] = value
    if not found:
        hint = "Write it with /OUTPUT and PRNSOL,U,COMP, without changing its headings"
        raise FormatError("the listing contains no nodal displacement", hint=hint, file=source)
    return StepResults.collected((_result(*key, node, source) for key, node in found.items()), source)


def _rows(text: str, source: str) -> Iterator[tuple[_Place, int, str]]:
    """Yield the lines with numbers, each with the load step and the columns to which it belongs."""
    place = _Place()
    for number, line in enumerate(text.splitlines(), start=1):
        step, frame, columns = _STEP.search(line), _FRAME.search(line), _columns(line)
        if step is not None:
            place = _Place(int(step[1]), int(step[2]))
        elif frame is not None:
            if " ".join(frame[1].split()) != _GLOBAL:
                hint = "List them in the global frame (RSYS,0) and state its directions with --frame"
                raise FormatError("the results are not in the global frame", hint=hint, file=source, row=number)
        elif columns:
            twice = next((name for name in columns if columns.count(name) > 1), None)
            if twice is not None:
                raise FormatError(f"the column {twice} appears more than once", file=source, row=number)
            place = _Place(place.load_step, place.substep, columns)
        elif not line.strip():
            place = _Place(place.load_step, place.substep)
        elif place.columns:
            if line.lstrip()[0].isdigit():
                yield place, number, line
            elif line.lstrip()[0].isalpha() or line.lstrip()[0] == "*":
                place = _Place(place.load_step, place.substep)
            else:
                raise FormatError(f"'{line.strip():.40}' is not a row of a listing", file=source, row=number)


def _columns(line: str) -> tuple[str, ...]:
    """Return the names of the columns if the line is the heading of a listing."""
    words = line.split()
    if len(words) < 2 or words[0] != "NODE" or not set(words[1:]) <= _KNOWN:
        return ()
    return tuple(words[1:])


def _values(line: str, columns: tuple[str, ...], source: str, row: int) -> tuple[int, dict[str, float]]:
    """Return the node and its components."""
    found = _ROW.fullmatch(line)
    rest = found[2].rstrip() if found else line
    if found is None or _NUMBER.sub("", rest):
        hint = "Numbers must be apart, or begin with their sign: list them with wider fields (/FORMAT)"
        raise FormatError(f"'{line.strip():.40}' is not a node with numbers", hint=hint, file=source, row=row)
    texts = [number.upper().replace("D", "E") for number in _NUMBER.findall(rest)]
    numbers = [float(text) for text in texts]
    if len(numbers) != len(columns):
        raise FormatError(f"{len(numbers)} numbers for the {len(columns)} columns", file=source, row=row)
    values = dict(zip(columns, numbers, strict=True))
    for name, value in values.items():
        if not math.isfinite(value):
            raise FormatError(f"{name} is not finite", file=source, row=row)
    _check_sum(values, sum(map(_last_digit, texts)), source, row)
    return int(found[1]), {name: value for name, value in values.items() if name in (*DISPLACEMENTS, *ROTATIONS)}


def _check_sum(values: dict[str, float], tolerance: float, source: str, row: int) -> None:
    """Raise FormatError if a listed sum is not the length of its vector: then the numbers were not split where they
    should be, or not all are in the same unit."""
    for names, total in ((DISPLACEMENTS, "USUM"), (ROTATIONS, "RSUM")):
        if total in values and all(name in values for name in names):
            length = math.hypot(*(values[name] for name in names))
            if abs(values[total] - length) > tolerance:
                message = f"{total} is {values[total]:.6g}, but {', '.join(names)} give {length:.6g}"
                raise FormatError(message, hint="List the results anew", file=source, row=row)


def _last_digit(number: str) -> float:
    """Return the value of one unit in the last digit of a number as it is written."""
    mantissa, _, exponent = number.partition("E")
    return 10.0 ** (int(exponent or 0) - len(mantissa.partition(".")[2]))


def _result(load_step: int, node: int, known: _Node, source: str) -> NodalResult:
    absent = [name for name in DISPLACEMENTS if name not in known.components]
    turned = [name for name in ROTATIONS if name in known.components]
    if 0 < len(turned) < len(ROTATIONS):
        absent += [name for name in ROTATIONS if name not in turned]
    if absent:
        message = f"{', '.join(absent)} of node {node} in load step {load_step} is not listed"
        raise FormatError(message, hint="List all components: PRNSOL,U,COMP and PRNSOL,ROT,COMP", file=source)
    ux, uy, uz = (known.components[name] for name in DISPLACEMENTS)
    if not turned:
        return NodalResult(load_step, node, (ux, uy, uz), None, known.row)
    rx, ry, rz = (known.components[name] for name in ROTATIONS)
    return NodalResult(load_step, node, (ux, uy, uz), (rx, ry, rz), known.row)
