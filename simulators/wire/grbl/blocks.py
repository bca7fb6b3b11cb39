"""Parser of G-code blocks, with the words, modal groups and error codes of GRBL 1.1.

Errors are checked in the same order as in GRBL. Positions are single-precision numbers, as in GRBL: a probe cycle is
refused if its target equals the position of the parser bit by bit. Arcs (G2, G3), predefined positions (G28, G30) and
inverse time (G93) are not simulated; they are answered with error 20.

Source: gnea/grbl, doc/markdown/commands.md, doc/csv/error_codes_en_US.csv and grbl/gcode.c.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np

EXPECTED_LETTER, BAD_NUMBER, NEGATIVE, UNSUPPORTED, MODAL_VIOLATION = 1, 2, 4, 20, 21
UNDEFINED_FEED, REPEATED, NO_AXIS_WORDS = 22, 25, 26
LINE_NUMBER, VALUE_MISSING, UNSUPPORTED_COORDINATES, G53_MODE, AXIS_WORDS_UNUSED = 27, 28, 29, 30, 31
INVALID_TARGET, UNUSED_WORDS, LENGTH_AXIS, TOOL_TOO_LARGE = 33, 36, 37, 38
INVALID_JOG = 16

MM_PER_INCH: Final = 25.4
LARGEST_LINE_NUMBER: Final = 9_999_999
LARGEST_TOOL: Final = 255  # MAX_TOOL_NUMBER: an unsigned number of 8 bits
AXES: Final = "XYZ"
Triple = tuple[float, float, float]
ORIGIN: Triple = (0.0, 0.0, 0.0)

_WORD = re.compile(r"([A-Z])([+-]?(?:\d+\.?\d*|\.\d+))?")
_GROUPS: Final[dict[str, set[float]]] = {
    "motion": {0, 1, 38.2, 38.3, 38.4, 38.5, 80},
    "plane": {17, 18, 19},
    "distance": {90, 91},
    "feed": {94},
    "units": {20, 21},
    "cutter": {40},
    "length": {43.1, 49},
    "coordinates": {54, 55, 56, 57, 58, 59},
    "control": {61},
    "once": {4, 10, 53, 92, 92.1},
    "M-flow": {0, 1, 2, 30},
    "M-spindle": {3, 4, 5},
    "M-coolant": {7, 8, 9},
}
PROBING: Final = frozenset({38.2, 38.3, 38.4, 38.5})


class BlockError(Exception):
    """Error in a block; `code` is the number after ``error:``."""

    def __init__(self, code: int) -> None:
        super().__init__(code)
        self.code = code


@dataclass(frozen=True)
class GrblModalState:
    """Modal state of the parser, with lengths in mm.

    A reset clears the offsets of G92 and G43.1, but not those of G54 to G59.
    """

    motion: float = 0
    plane: float = 17
    distance: float = 90
    units: float = 21
    coordinates: int = 54
    spindle: float = 5
    coolant: float = 9
    feed_mm_per_min: float = 0.0
    speed_rpm: float = 0.0
    tool: int = 0
    g92_mm: Triple = ORIGIN
    tool_length_mm: float = 0.0


@dataclass(frozen=True)
class GcodeBlock:
    """Actions requested by one line. `target_mm` is the target in machine coordinates, or None if no axis moves."""

    motion: float | None = None
    target_mm: Triple | None = None
    dwell_s: float | None = None
    program_end: bool = False


@dataclass
class WorkOffsets:
    """Work offsets G54 to G59 in mm. Each offset gives the machine coordinates of the point with work coordinates 0."""

    systems: dict[int, Triple] = field(default_factory=lambda: dict.fromkeys(range(54, 60), ORIGIN))

    def work_offset(self, modes: GrblModalState) -> Triple:
        """Return the work coordinate offset (``WCO``) in mm: machine position = work position + offset."""
        x, y, z = self.systems[modes.coordinates]
        gx, gy, gz = modes.g92_mm
        return x + gx, y + gy, z + gz + modes.tool_length_mm


def parse_words(line: str) -> list[tuple[str, float]]:
    """Return the letters and values of the words in a line from which blanks and comments have been removed.

    Values are numbers of single precision. Raises BlockError if the line is malformed.
    """
    words: list[tuple[str, float]] = []
    at = 0
    while at < len(line):
        match = _WORD.match(line, at)
        if match is None:
            raise BlockError(EXPECTED_LETTER)
        if match[2] is None:
            raise BlockError(BAD_NUMBER)
        words.append((match[1], float(match[2])))
        at = match.end()
    return words


class BlockParser:
    """Parser of consecutive lines, which keeps the modal state. A line with an error does not change this state."""

    def __init__(self, offsets: WorkOffsets) -> None:
        self.offsets = offsets
        self.modes = GrblModalState()

    @property
    def work_offset_mm(self) -> Triple:
        return self.offsets.work_offset(self.modes)

    def read(self, line: str, machine_mm: Triple) -> GcodeBlock:
        """Parse one line. Raises BlockError if the line has an error.

        `machine_mm` is the end position of the previous line in machine coordinates.
        """
        codes, values = self._classify_words(parse_words(line))
        modes = self._modes(codes, values)
        once = codes.get("once")
        unused = set(values) - {"N", "F", "S", "T"}
        block = GcodeBlock(program_end=codes.get("M-flow") in (2, 30))
        if once == 4:
            if "P" not in values:
                raise BlockError(VALUE_MISSING)
            block, unused = replace(block, dwell_s=values["P"]), unused - {"P"}
        elif once in (10, 92, 92.1) or codes.get("length") == 43.1:
            modes, used = self._offset(once, values, modes, machine_mm)
            unused -= used
        else:
            block, used = self._motion(codes, values, modes, machine_mm, block)
            unused -= used
        if unused & set(AXES):
            raise BlockError(AXIS_WORDS_UNUSED)
        if unused:
            raise BlockError(UNUSED_WORDS)
        self.modes = replace(modes, motion=1, distance=90, coordinates=54) if block.program_end else modes
        return block

    def _classify_words(self, words: list[tuple[str, float]]) -> tuple[dict[str, float], dict[str, float]]:
        codes: dict[str, float] = {}
        values: dict[str, float] = {}
        for letter, value in words:
            if letter in "GM":
                group = _group_of(letter, value)
                if group in codes:
                    raise BlockError(MODAL_VIOLATION)
                codes[group] = value
            elif letter not in "XYZFSPLNT":
                raise BlockError(UNSUPPORTED)
            elif letter == "T" and value > LARGEST_TOOL:
                raise BlockError(TOOL_TOO_LARGE)
            elif letter in values:
                raise BlockError(REPEATED)
            elif letter in "FNPTS" and value < 0.0:
                raise BlockError(NEGATIVE)
            else:
                values[letter] = value
        if "N" in values and not (values["N"].is_integer() and 1 <= values["N"] <= LARGEST_LINE_NUMBER):
            raise BlockError(LINE_NUMBER)
        return codes, values

    def _modes(self, codes: dict[str, float], values: dict[str, float]) -> GrblModalState:
        modes = self.modes
        modes = replace(
            modes,
            plane=codes.get("plane", modes.plane),
            distance=codes.get("distance", modes.distance),
            units=codes.get("units", modes.units),
            coordinates=int(codes.get("coordinates", modes.coordinates)),
            motion=codes.get("motion", modes.motion),
            spindle=codes.get("M-spindle", modes.spindle),
            coolant=codes.get("M-coolant", modes.coolant),
            speed_rpm=values.get("S", modes.speed_rpm),
            tool=int(values.get("T", modes.tool)),
            tool_length_mm=0.0 if codes.get("length") == 49 else modes.tool_length_mm,
        )
        return replace(modes, feed_mm_per_min=values["F"] * _scale(modes)) if "F" in values else modes

    def read_jog(self, line: str, machine_mm: Triple) -> tuple[Triple, float]:
        """Return the target and the feed in mm/min of a jog command ``$J=``, which does not change the modal state.

        Raises BlockError if the command has an error.
        """
        codes, values = self._classify_words(parse_words(line))
        if not set(codes) <= {"units", "distance", "once"} or codes.get("once", 53) != 53 or set(values) - set("XYZFN"):
            raise BlockError(INVALID_JOG)
        if not set(values) & set(AXES):
            raise BlockError(NO_AXIS_WORDS)
        if not values.get("F", 0.0) > 0.0:
            raise BlockError(UNDEFINED_FEED)
        modes = self._modes(codes, values)
        return self._target(values, modes, machine_mm, absolute="once" in codes), modes.feed_mm_per_min

    def _motion(
        self,
        codes: dict[str, float],
        values: dict[str, float],
        modes: GrblModalState,
        machine_mm: Triple,
        block: GcodeBlock,
    ) -> tuple[GcodeBlock, set[str]]:
        axis_words = {letter for letter in values if letter in AXES}
        absolute = codes.get("once") == 53
        if absolute and modes.motion not in (0, 1):
            raise BlockError(G53_MODE)
        if modes.motion in PROBING and "motion" in codes and not axis_words:
            raise BlockError(NO_AXIS_WORDS)
        if not axis_words or modes.motion == 80:
            return block, set()
        if modes.motion != 0 and modes.feed_mm_per_min <= 0.0:
            raise BlockError(UNDEFINED_FEED)
        target = self._target(values, modes, machine_mm, absolute=absolute)
        if modes.motion in PROBING and target == machine_mm:
            raise BlockError(INVALID_TARGET)
        return replace(block, motion=modes.motion, target_mm=target), axis_words

    def _target(self, values: dict[str, float], modes: GrblModalState, machine_mm: Triple, *, absolute: bool) -> Triple:
        offset = self.offsets.work_offset(modes)
        scale = _scale(modes)
        target = list(machine_mm)
        for axis, letter in enumerate(AXES):
            if letter not in values:
                continue
            value = single(values[letter] * scale)
            if absolute:
                target[axis] = value
            elif modes.distance == 91:
                target[axis] = single(target[axis] + value)
            else:
                target[axis] = single(value + single(offset[axis]))
        return target[0], target[1], target[2]

    def _offset(
        self, once: float | None, values: dict[str, float], modes: GrblModalState, machine_mm: Triple
    ) -> tuple[GrblModalState, set[str]]:
        scale = _scale(modes)
        given = {letter: values[letter] * scale for letter in AXES if letter in values}
        if once == 92.1:
            return replace(modes, g92_mm=ORIGIN), set()
        if not given:
            raise BlockError(NO_AXIS_WORDS)
        if once == 92:
            base = self.offsets.work_offset(replace(modes, g92_mm=ORIGIN))
            return replace(
                modes, g92_mm=_replace_axes(modes.g92_mm, given, lambda i, v: machine_mm[i] - base[i] - v)
            ), set(given)
        if once == 10:
            return self._store_system(values, given, modes, machine_mm), set(given) | {"P", "L"}
        if set(given) != {"Z"}:
            raise BlockError(LENGTH_AXIS)
        return replace(modes, tool_length_mm=given["Z"]), {"Z"}

    def _store_system(
        self, values: dict[str, float], given: dict[str, float], modes: GrblModalState, machine_mm: Triple
    ) -> GrblModalState:
        if not {"P", "L"} <= set(values):
            raise BlockError(VALUE_MISSING)
        if not np.isfinite(values["P"]):  # a number of hundreds of digits
            raise BlockError(UNSUPPORTED_COORDINATES)
        system = int(values["P"]) + 53 if values["P"] else modes.coordinates
        if values["L"] not in (2, 20) or system not in self.offsets.systems:
            raise BlockError(UNSUPPORTED_COORDINATES if system not in self.offsets.systems else UNSUPPORTED)
        relative = values["L"] == 20
        self.offsets.systems[system] = _replace_axes(
            self.offsets.systems[system], given, lambda i, v: machine_mm[i] - v if relative else v
        )
        return modes


def _replace_axes(offset: Triple, given: dict[str, float], value: Callable[[int, float], float]) -> Triple:
    new = [value(i, given[a]) if a in given else offset[i] for i, a in enumerate(AXES)]
    return new[0], new[1], new[2]


def single(value: float) -> float:
    """Return `value` rounded to single precision, in which GRBL computes positions.

    Like GRBL, return an infinite value without a word if `value` exceeds single precision.
    """
    with np.errstate(over="ignore"):
        return float(np.float32(value))


def _scale(modes: GrblModalState) -> float:
    return MM_PER_INCH if modes.units == 20 else 1.0


def _group_of(letter: str, value: float) -> str:
    prefix = "M-" if letter == "M" else ""
    for group, members in _GROUPS.items():
        if group.startswith("M-") == bool(prefix) and value in members:
            return group
    raise BlockError(UNSUPPORTED)
