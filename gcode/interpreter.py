"""Interpreter of a part program. It tracks the modal state (such as units, plane and distance mode) and the programmed
axis positions from block to block.

The codes of one block are executed in the order of RS-274/NGC (NISTIR 6556, table 8). The order is: feed mode, tool,
plane, units, tool length, coordinate system, distance mode, codes that use the axis words, and stops.
"""

from __future__ import annotations

import math
from collections.abc import Callable

from gcode import datum
from gcode.arcs import PLANE_AXES, Arc, read_arc
from gcode.codes import (
    FIRST,
    MOTIONS,
    PROGRAM_END,
    STOPS,
    TOOL_CHANGE,
    TOOL_NAMED,
    check_codes,
    check_letters,
    remember_words,
)
from gcode.lines import MoveBlock
from gcode.modal import INVERSE_TIME, MACHINE_FRAME, MM_PER_INCH, SYSTEM_CODES, ModalState
from gcode.polar import POLAR
from gcode.setup import NO_OFFSET, CorrectionOptions, PartSetup, Triple
from gcode.source import SourceLine
from gcode.words import Block, code_number, is_program_number, read_block, read_plain
from gcode.writer import ProgramWriter

MARK = "volcal gcode correct"
"""Text in a comment of every corrected program, by which a second correction of the same program is refused."""

_AXES = frozenset("XYZ") | POLAR
_ARC = frozenset("IJKR")
_GEOMETRY = _AXES | _ARC
_ONCE = frozenset("FSTHD")
_BLENDING = 640
_PASSABLE = frozenset("NSF")
_ARCS = (20, 30)
_LINEAR = (0, 10)
_REFERENCES = {280: "G28", 300: "G30"}
_STORED = {281: "G28", 301: "G30"}
_DATUM = frozenset((920, 921, 922, 923))
_OFFSETS = 100
# Arcs are written as straight pieces: a corrected circle is not a circle.
_WRITTEN = {0: "G0", 10: "G1", 20: "G1", 30: "G1"}
_DWELL, _MACHINE, _DYNAMIC_LENGTH, _CANCEL = 40, 530, 431, 800
# Codes for which the axis words of the block are not a target in the coordinates of the program.
_SPECIAL = frozenset((_DWELL, _MACHINE, _DYNAMIC_LENGTH, _OFFSETS, *_REFERENCES, *_STORED, *_DATUM))
_UNCLEAR = "the effect of {} in each piece is not known"
_UNSURE = "M{} takes effect before the motion on some controllers and after it on others"


class Interpreter:
    """Interpreter of a part program that passes moves and unchanged lines to a writer.

    `heading` is a comment that is written before the first block.
    """

    def __init__(self, setup: PartSetup, options: CorrectionOptions, writer: ProgramWriter, heading: str) -> None:
        self.modal = ModalState(setup)
        self._options = options
        self._writer = writer
        self._heading = heading
        self._position_known = self.modal.position_known
        self._coded = True
        self._flowing = False

    def feed(self, source: SourceLine, text: str) -> None:
        """Process one block of the program. `text` is the block without line end, and `source` is the line from which
        it comes. Raises FormatError if the block cannot be corrected.
        """
        if self._flowing and self._plain_move(source, text):
            return
        if text.lstrip().startswith("%"):
            # The first % opens the tape, the second one ends it.
            self.modal.ended = self.modal.begun
            self._flowing = False
            self._writer.write_unchanged(text)
            return
        block = read_block(text, source)
        if MARK in block.comments:
            block.refuse("this program was already corrected", "Correct the original program")
        if not self.modal.begun and is_program_number(block):
            self._writer.write_unchanged(text)
            return
        if self._heading and text.strip():
            self._writer.write_unchanged(self._heading)
            self._heading = ""
        if block.tokens:
            self._block(block)
        else:
            self._writer.write_unchanged(text)

    @property
    def _may_flow(self) -> bool:
        """Return True if the fast path may be used in the present state.

        A line with only N, G0 or G1, X, Y, Z and F is then a plain move to be corrected.
        """
        modal = self.modal
        known = self._position_known and modal.offset is not None and not modal.ended
        return known and modal.motion in _LINEAR and not modal.inverse_time and not self._heading

    def _plain_move(self, source: SourceLine, text: str) -> bool:
        """Process a plain move on the fast path; return False for any other line."""
        words = read_plain(text)
        if words is None:
            return False
        number, code, x, y, z, feed = words
        if x is None and y is None and z is None:
            return False
        modal = self.modal
        unit, position = modal.unit_mm, modal.position
        # Absolute words count from the zero point, incremental words from the programmed position.
        base = modal.offset if modal.absolute else position
        if base is None:
            return False
        mask, coded = 0, self._coded
        if code is not None:
            modal.motion, coded = (10 if code == "1" else 0), True
        end_x, end_y, end_z = position
        if x is not None:
            mask, end_x = 1, float(x) * unit + base[0]
        if y is not None:
            mask, end_y = mask | 2, float(y) * unit + base[1]
        if z is not None:
            mask, end_z = mask | 4, float(z) * unit + base[2]
        head = f"N{number} " if number else ""
        tail = ""
        if feed:
            tail = f" F{feed}"
            modal.words["F"] = tail[1:]
        written = "G1" if modal.motion else "G0"
        move = MoveBlock(source, written, coded, False, mask, head, tail, "", "", 0.0, "")
        self._writer.move(move, (end_x, end_y, end_z), modal.frame, None)
        modal.position = [end_x, end_y, end_z]
        self._coded = False
        return True

    def _block(self, block: Block) -> None:
        modal = self.modal
        modal.begun = True
        if modal.ended:
            block.refuse("the block is after the end of the program", "Remove it: some controllers would execute it")
        check_letters(block)
        if block.g or block.m or block.deletable or "T" in block.values:
            check_codes(block, self._options.kept_g)
            if block.deletable:
                _check_deletable(block)
            self._set_modes(block)
            remember_words(block, modal.words)
        elif "F" in block.values or "S" in block.values:
            remember_words(block, modal.words)
        self._use_axis_words(block)
        if block.m:
            modal.ended = any(code in PROGRAM_END for code in block.m)
        self._flowing = self._may_flow

    def _set_modes(self, block: Block) -> None:
        """Set all modes except the motion mode, in the order of RS-274/NGC."""
        modal, codes = self.modal, block.g
        if "T" in block.values:
            # T only selects a tool; M6 loads it.
            modal.tool_called = int(block.values["T"])
        if TOOL_CHANGE in block.m:
            self._change_tool(block)
        if TOOL_NAMED in block.m:
            modal.tool_held = int(block.values["Q"]) if block.values.get("Q", -1.0) >= 0.0 else None
        if not codes or (len(codes) == 1 and codes[0] in MOTIONS):
            return
        for code in codes:
            _MODES.get(code, _nothing)(modal)
        # The moves collected so far must be written in the old unit.
        if modal.unit_mm != self._writer.unit_mm:
            self._writer.flush()
            self._writer.resume_at(_triple(modal.position), self._writer.position, modal.unit_mm)
        # The lengths of G43.1 are in the unit that the same block may set, so they are read after the modes.
        if 430 in codes:
            modal.tool_offset = self._tool_length(block)
        if _DYNAMIC_LENGTH in codes:
            datum.set_tool_length(block, modal)
        modal.update_frame()

    def _change_tool(self, block: Block) -> None:
        self.modal.tool_held = self.modal.tool_called
        if self.modal.setup.tool_change_moves:
            if not _AXES.isdisjoint(block.values):
                block.refuse("a tool change and a move in one block", "Write them as two")
            datum.forget_position(self.modal, self._writer)
            self.modal.lost_at_tool_change = True
            self._position_known = False

    def _tool_length(self, block: Block) -> Triple:
        number = block.values.get("H", self.modal.tool_held)
        if number is None:
            block.refuse("G43 without H, and no tool was loaded", "Write the H word")
        offset = self.modal.setup.tools.get(int(number))
        if offset is None or number != int(number):
            block.refuse(f"the length of tool {number:g} is not known", f"Give it: --tool {number:g}=X,Y,Z")
        return offset

    def _use_axis_words(self, block: Block) -> None:
        """Execute the code that uses the axis words."""
        modal, special = self.modal, 0
        for code in block.g:
            if code in MOTIONS:
                modal.motion = code
            elif code == _CANCEL:
                modal.motion = None
            elif code in _SPECIAL:
                special = code
        if special and special != _MACHINE:
            self._use_axis_words_specially(block, special)
        elif not _AXES.isdisjoint(block.values) or (modal.motion in _ARCS and not _ARC.isdisjoint(block.values)):
            self._move(block, special == _MACHINE)
        else:
            self._keep(block)

    def _use_axis_words_specially(self, block: Block, code: int) -> None:
        """Execute a code that gives the axis words a meaning of its own: G4, G28, G30, G43.1, G92 and others."""
        stated = [other for other in block.g if other in MOTIONS]
        named = _AXES.intersection(block.values)
        if stated and not (stated == [0] and code in _REFERENCES):
            block.refuse("two G codes use the axis words", "Write two blocks")
        if not POLAR.isdisjoint(named):
            block.refuse("polar coordinates together with a code that uses the axis words", "Write two blocks")
        # G4 X is a dwell time on Fanuc-like controllers. With P as well, some controllers would read X as a move.
        if code == _DWELL and named and (named != {"X"} or "P" in block.values):
            block.refuse("a dwell with axis words is a move on some controllers", "Write two blocks")
        if code in _DATUM:
            if named and code != 920:
                block.refuse("this G code takes no axis words")
            datum.set_datum(block, code, self.modal, self._writer)
        elif code in _REFERENCES:
            datum.go_to_reference(block, _REFERENCES[code], self.modal, self._writer)
            self._position_known = self.modal.position_known
        elif code in _STORED:
            datum.store_reference(block, _STORED[code], self.modal, self._writer)
        elif code == _OFFSETS:
            datum.set_work_offset(block, self.modal, self._writer)
        else:
            self._writer.write_unchanged(block.text)
        self._coded = True

    def _keep(self, block: Block) -> None:
        self._writer.write_unchanged(block.text)
        self._coded = self._coded or any(code in MOTIONS or code == _CANCEL for code in block.g)

    def _move(self, block: Block, machine: bool) -> None:
        modal, motion = self.modal, self.modal.motion
        if motion is None:
            block.refuse("axis words, but none of G0 to G3 is in effect", "State the G code")
        # Controllers differ on G53 with G91: LinuxCNC takes the words as absolute, Fanuc ignores the block.
        if machine and (motion in _ARCS or not modal.absolute):
            block.refuse("G53 requires G0 or G1, and G90")
        if motion not in _ARCS and not _ARC.isdisjoint(block.values):
            block.refuse(f"I, J, K and R belong to arcs, but G{motion // 10} is in effect")
        end = datum.target_position(block, modal, machine)
        if not self._position_known and not self._begin_from_unknown_position(block, end, machine, motion):
            return
        arc = self._arc(block, end, motion) if motion in _ARCS else None
        self._writer.move(self._as_move(block, machine, motion), end, MACHINE_FRAME if machine else modal.frame, arc)
        modal.position = list(end)
        self._coded = False

    def _begin_from_unknown_position(self, block: Block, end: Triple, machine: bool, motion: int) -> bool:
        """Return True if a rapid move from an unknown position can be corrected, because all axis positions are known
        after it.

        Otherwise the rapid move is written unchanged. Any other motion is refused.
        """
        if motion != 0:
            message = "the position of the axes before this block is not known"
            block.refuse(message, f"Begin with G0 moves that name X, Y and Z. {self.modal.start_hint}")
        self._coded = True
        # A rapid move that names all unknown axes ends at a known position, so its end can be corrected.
        self._position_known = not any(map(math.isnan, end))
        if self._position_known:
            self._writer.flush()
            self._writer.resume_at(end, self._writer.position, self.modal.unit_mm)
        else:
            datum.move_from_unknown_position(block, end, machine, self.modal, self._writer)
        return self._position_known

    def _arc(self, block: Block, end: Triple, motion: int) -> Arc:
        modal = self.modal
        return read_arc(
            block,
            modal.position,
            end,
            clockwise=motion == 20,
            axes=PLANE_AXES[modal.plane],
            unit_mm=modal.unit_mm,
            centre_origin=datum.program_zero(block, modal) if modal.absolute_centres else None,
        )

    def _as_move(self, block: Block, machine: bool, motion: int) -> MoveBlock:
        head, tail, stop = "", "", ""
        values, inverse, coded, whole = block.values, 0.0, self._coded, ""
        # With G93, F holds for its own move only; rapid moves have none.
        timed = self.modal.inverse_time and motion != 0
        for letter, number, _ in block.tokens:
            if letter in _GEOMETRY or (letter == "P" and motion in _ARCS):
                continue
            if letter == "G":
                code = code_number(number)
                if code in MOTIONS:
                    coded = True
                elif code != _MACHINE:
                    head += f"G{number} "
            elif letter == "N":
                head = f"N{number} {head}"
            elif letter == "F" and timed:
                inverse = values["F"]
            elif letter != "M":
                tail += f" {letter}{number}"
                # A word whose effect in each piece is unknown (such as P of some M codes) forbids dividing the move. P
                # and Q of G64 are tolerances and may be written once.
                if letter not in _ONCE and _BLENDING not in block.g:
                    whole = _UNCLEAR.format(letter)
            elif code_number(number) in STOPS:
                stop += f" M{number}"
            else:
                tail += f" M{number}"
                whole = whole if code_number(number) in FIRST else _UNSURE.format(number)
        if timed and not inverse > 0.0:
            block.refuse("with G93 every move needs its own F", "Write the F word")
        comment = f" {block.comments}" if block.comments else ""
        polar = not POLAR.isdisjoint(values)
        mask = (polar or "X" in values) + 2 * (polar or "Y" in values) + 4 * ("Z" in values)
        return MoveBlock(
            block.source, _WRITTEN[motion], coded, machine, mask, head, tail, stop, comment, inverse, whole
        )


def _check_deletable(block: Block) -> None:
    harmless = not block.g and _PASSABLE.issuperset(block.values)
    if not harmless or any(code == TOOL_CHANGE or code in PROGRAM_END for code in block.m):
        message = "block delete makes this block optional, and the following blocks depend on it"
        block.refuse(message, "Remove the slash or the block")


def _nothing(_: ModalState) -> None:
    """Ignore a code that changes nothing in the modal state."""


def _setter(name: str, value: object) -> Callable[[ModalState], None]:
    return lambda modal: setattr(modal, name, value)


_MODES: dict[int, Callable[[ModalState], None]] = {
    **{code: _setter("plane", code) for code in PLANE_AXES},
    **{code: _setter("system", name) for code, name in SYSTEM_CODES.items()},
    200: _setter("unit_mm", MM_PER_INCH),
    210: _setter("unit_mm", 1.0),
    490: _setter("tool_offset", NO_OFFSET),
    900: _setter("absolute", True),
    901: _setter("absolute_centres", True),
    910: _setter("absolute", False),
    911: _setter("absolute_centres", False),
    **{code: _setter("feed_mode", code) for code in (INVERSE_TIME, 940, 950)},
}


def _triple(values: list[float]) -> Triple:
    x, y, z = values
    return x, y, z
