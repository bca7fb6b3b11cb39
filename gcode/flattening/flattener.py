"""Execution of a part program line by line, which yields the plain blocks that the controller would execute.

Lines are read one by one until the first O-word or M98. From there on, all lines are kept in memory, because the
program may jump among them.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

from gcode.flattening.canned_cycles import CannedCycles, cartesian
from gcode.flattening.control_flow import (
    END_OF_DO,
    PROGRAM_NUMBER,
    ControlFlow,
    OWord,
    read_control,
)
from gcode.flattening.expressions import ExpressionReader
from gcode.flattening.parameters import LOCAL_NUMBERS, ProgramParameters
from gcode.flattening.saved_state import (
    INVALIDATE,
    SAVE,
    SAVE_FOR_RETURN,
    STATE_CODES,
    SavedState,
)
from gcode.flattening.statements import Statement, block_text, read_statement, shows_parameters
from gcode.flattening.system_parameters import SystemParameters
from gcode.modal import ModalState
from gcode.polar import POLAR
from gcode.source import SourceLine

SubprogramFiles = Callable[[str], Iterable[str] | None]
"""Function that returns the lines of the file of a subprogram with this name, or None if there is no such file."""

# Anything that is not a plain block: parameters, expressions, O-words, (ABORT), the codes of canned cycles and of their
# end (G73, G8x, G98, G99), the codes on which cycles depend (G61, G64, M3 to M5), saved states (M70 to M73), and M98
# and M99. The G and M words may have spaces and leading zeros.
_SPECIAL = re.compile(
    r"[#\[oO]|[gG][ \t]*0*(?:61|64|73|8[0-9]|9[89])(?!\d)|[mM][ \t]*0*(?:[345]|7[0-3]|9[89])(?!\d)|\([ \t]*[aA][bB]"
)
_ABORT = re.compile(r"\([ \t]*abort\b", re.IGNORECASE)
_CALL, _RETURN = 980, 990
_STATE_CODES = frozenset(STATE_CODES)
# Whether a recursion or a loop ends cannot be known in advance, hence the limits. Lines that are executed count, and
# blocks of canned cycles; a long program may execute more than a short one.
_MOST_CALLS = 100
_MOST_EXECUTED = 2_000_000
_MOST_EXECUTED_PER_LINE = 20
_MOST_WITHOUT_BLOCK = 100_000
_MOST_ARGUMENTS = len(LOCAL_NUMBERS)


class PlainBlock(NamedTuple):
    """Plain block and the line of the part program from which it comes."""

    source: SourceLine
    text: str


@dataclass(slots=True)
class _Call:
    """Execution of a subprogram, or of the part program itself.

    `index` is the index of the next line in `section`, `first` that of the first line of a subprogram. `repeats` is the
    number of executions that follow the present one. `counts` contains the remaining passes of the `repeat` loops.
    """

    section: ControlFlow
    index: int
    first: int = 0
    label: str = ""
    numbered: bool = False
    repeats: int = 0
    counts: dict[int, int] = field(default_factory=dict)
    saved: SavedState | None = None
    saved_cycle_modes: tuple[bool | None, bool] = (None, False)


class Flattener:
    """Front end of the interpreter, which executes everything that is not a plain block.

    `modal` is the state of the interpreter that executes the yielded blocks. Each block must be executed before the
    next one is requested, because expressions and canned cycles depend on the state. `given` contains the values of
    parameters before the program. `files` finds subprograms that are not in the program.
    """

    def __init__(self, modal: ModalState, given: Mapping[str, float], files: SubprogramFiles) -> None:
        self._modal = modal
        self._system = SystemParameters(modal)
        self._parameters = ProgramParameters(given, self._system.value)
        self._files = files
        retract = modal.setup.retract
        self._cycles = CannedCycles(to_r=None if retract is None else retract == "G99")
        self._calls: list[_Call] = []
        self._known: dict[str, tuple[ControlFlow, int]] = {}
        self._lines = 0
        self._executed = 0
        self._without_block = 0
        self._percent = False

    def blocks(self, lines: Iterable[str]) -> Iterator[PlainBlock]:
        """Yield the plain blocks of a part program. Raises FormatError for a line that cannot be executed."""
        numbered = enumerate(lines, start=1)
        for number, text in numbered:
            self._lines = number
            source = SourceLine(number, text.rstrip("\r\n"))
            if not self._cycles.active and _SPECIAL.search(source.text) is None:
                self._percent |= source.text.startswith("%")
                yield PlainBlock(source, source.text)
            elif self._jumps(source):
                # Line numbers continue, because `numbered` is the same iterator.
                rest = [source, *(SourceLine(later, line.rstrip("\r\n")) for later, line in numbered)]
                self._lines = rest[-1].number
                for block in self._run(rest):
                    self._without_block = 0
                    yield block
                return
            else:
                yield from self._simple(source, self._statement(source))

    def _jumps(self, source: SourceLine) -> bool:
        """Return True if the line contains an O-word, M70 to M73, M98 or M99, except the number of the program."""
        code, _ = source.split_comments()
        control = read_control(source) if "o" in code else None
        if control is not None:
            return control.keyword != PROGRAM_NUMBER or self._modal.begun
        return re.search(r"m0*(?:9[89]|7[0-3])(?!\d)", code) is not None

    def _run(self, lines: list[SourceLine]) -> Iterator[PlainBlock]:
        """Execute the lines of the part program from the first O-word on."""
        section = ControlFlow.of(lines)
        if not self._modal.ended:
            self._calls = [_Call(section, 0)]
            self._learn(section)
            yield from self._execute()
        last = next((source for source in reversed(lines) if source.text.strip()), lines[-1])
        if self._percent and last.text.strip() == "%":
            yield PlainBlock(last, "%")

    def _execute(self) -> Iterator[PlainBlock]:
        while self._calls and not self._modal.ended:
            call = self._calls[-1]
            if call.index >= len(call.section.lines):
                if call.label:
                    call.section.lines[-1].refuse(f"the subprogram {call.label} has no end")
                return
            index, source = call.index, call.section.lines[call.index]
            call.index += 1
            self._count(source)
            control = call.section.controls.get(index)
            if control is not None:
                # M73 restores the state when its subroutine returns, before the caller continues.
                if control.keyword in ("endsub", "return") and call.saved is not None and call.saved.at_return:
                    yield from self._restore(call.saved, source)
                self._control(call, index, control, source)
            elif not self._cycles.active and _SPECIAL.search(source.text) is None:
                if not source.text.startswith("%"):
                    yield PlainBlock(source, source.text)
            else:
                yield from self._line(source)

    def _line(self, source: SourceLine) -> Iterator[PlainBlock]:
        """Execute a line that is neither plain nor an O-word."""
        statement = self._statement(source)
        codes = statement.codes("M")
        if not _STATE_CODES.isdisjoint(codes):
            yield from self._state(statement, codes)
        elif _CALL in codes or _RETURN in codes:
            others = [word for word in statement.words if word.letter not in "MPLN"]
            if others or len(codes) > 1 or statement.deletable:
                source.refuse("M98 and M99 are supported only in blocks of their own")
            self._assign(statement)
            if _CALL in codes:
                self._call_numbered(statement)
            else:
                self._return_numbered(statement)
        else:
            yield from self._simple(source, statement)

    def _state(self, statement: Statement, codes: list[int]) -> Iterator[PlainBlock]:
        """Execute M70 to M73."""
        source, call = statement.source, self._calls[-1]
        if len(codes) > 1 or any(word.letter not in "MN" for word in statement.words) or statement.deletable:
            source.refuse("M70 to M73 are supported only in blocks of their own")
        if codes[0] in (SAVE, SAVE_FOR_RETURN):
            call.saved = SavedState.of(self._modal, at_return=codes[0] == SAVE_FOR_RETURN)
            call.saved_cycle_modes = self._cycles.modes
        elif codes[0] == INVALIDATE:
            call.saved = None
        elif call.saved is None:
            source.refuse("M72 restores a state, but none was saved by M70 in this program or subroutine")
        else:
            yield from self._restore(call.saved, source)

    def _restore(self, saved: SavedState, source: SourceLine) -> Iterator[PlainBlock]:
        for text in saved.restored(self._modal, source):
            yield PlainBlock(source, text)
        self._cycles.modes = self._calls[-1].saved_cycle_modes

    def _simple(self, source: SourceLine, statement: Statement) -> Iterator[PlainBlock]:
        """Execute a statement, and yield its block if it has one."""
        if _ABORT.search(source.text):
            source.refuse("the program stops here: (ABORT)")
        if statement.deletable and (statement.assignments or statement.computed):
            source.refuse("block delete makes this line optional, and it depends on parameters", "Remove the slash")
        cycle = self._cycles.wants(statement)
        words = statement.words
        if cycle:
            yield from self._cycle(source, statement)
        elif statement.computed or statement.assignments:
            if words:
                yield PlainBlock(source, block_text(words, statement.comments))
        elif not any(map(shows_parameters, statement.comments)):
            yield PlainBlock(source, source.text)
        elif words:
            yield PlainBlock(source, block_text(words, statement.comments))
        self._assign(statement)

    def _cycle(self, source: SourceLine, statement: Statement) -> Iterator[PlainBlock]:
        if statement.deletable:
            source.refuse("block delete makes a canned cycle optional", "Remove the slash or the block")
        others, own = self._cycles.split(statement)
        if others:
            yield PlainBlock(source, block_text(others, statement.comments))
        times = self._cycles.repeats(own, source)
        # With G91, polar coordinates depend on the position, so each repetition is converted after the one before has
        # been executed. With G90, all repetitions are at one place.
        one_by_one = not self._modal.absolute and any(word.letter in POLAR for word in own)
        for _ in range(times if one_by_one else 1):
            words = cartesian(own, source, self._modal)
            for text in self._cycles.run(words, 1 if one_by_one else times, source, self._modal):
                self._count(source)
                yield PlainBlock(source, text)

    def _statement(self, source: SourceLine) -> Statement:
        return read_statement(source, self._parameters)

    def _assign(self, statement: Statement) -> None:
        for key, value in statement.assignments:
            self._parameters.assign(key, value, statement.source)

    def _count(self, source: SourceLine) -> None:
        """Count a line that is executed, or a block of a canned cycle."""
        self._executed += 1
        self._without_block += 1
        if self._without_block > _MOST_WITHOUT_BLOCK:
            message = f"{_MOST_WITHOUT_BLOCK} lines were executed one after the other without a block"
            source.refuse(message, "A loop around this line may be endless")
        if self._executed > _MOST_EXECUTED + _MOST_EXECUTED_PER_LINE * self._lines:
            message = (
                f"{self._executed - 1} lines and blocks of canned cycles were executed, the most for a program of"
                f" {self._lines} lines, and the program is still running here"
            )
            hint = "A loop around this line may be endless, or a canned cycle have too many repetitions"
            source.refuse(message, hint)

    def _control(self, call: _Call, index: int, control: OWord, source: SourceLine) -> None:
        keyword, section = control.keyword, call.section
        if keyword == "sub":
            call.index = section.partners[index] + 1
        elif keyword == "call":
            self._call(control, source)
        elif keyword in ("endsub", "return"):
            self._return(control, source)
        elif keyword in ("elseif", "else"):
            # Execution that runs into `elseif` or `else` comes from a branch that was chosen, and skips the others.
            call.index = section.ends[index] + 1
        elif keyword == "if":
            self._choose(call, index)
        elif keyword in ("break", "continue"):
            self._leave_loop(call, section.partners[index], again=keyword == "continue")
        elif keyword == PROGRAM_NUMBER:
            if call.label or self._modal.begun:
                message = "the main program runs into the number of a subprogram"
                source.refuse(message, "End the main program with M2 or M30, and the subprogram with M99")
        else:
            self._loop(call, index, control, source)

    def _loop(self, call: _Call, index: int, control: OWord, source: SourceLine) -> None:
        partners, keyword = call.section.partners, control.keyword
        if keyword == "while":
            if not self._expression(control, source):
                call.index = partners[index] + 1
        elif keyword == "endwhile":
            call.index = partners[index]
        elif keyword == END_OF_DO:
            if self._expression(control, source):
                call.index = partners[index]
        elif keyword == "repeat":
            # The number of passes is computed once, when the loop begins.
            count = call.counts[index] if index in call.counts else round(self._expression(control, source))
            if count > 0:
                call.counts[index] = count - 1
            else:
                call.counts.pop(index, None)
                call.index = partners[index] + 1
        elif keyword == "endrepeat":
            call.index = partners[index]

    def _choose(self, call: _Call, index: int) -> None:
        """Go to the first branch of a condition that is true."""
        section = call.section
        while True:
            control, source = section.controls[index], section.lines[index]
            if control.keyword in {"endif", "else"} or self._expression(control, source):
                call.index = index + 1
                return
            index = section.partners[index]

    def _leave_loop(self, call: _Call, begin: int, *, again: bool) -> None:
        lines = call.section.loop_lines(begin)
        # Repeat loops inside begin anew when the program comes back to them. `continue` keeps the count of its own
        # loop.
        for index in [index for index in call.counts if index in lines and (index != begin or not again)]:
            del call.counts[index]
        end = lines[-1]
        # The end of the loop decides whether another pass follows.
        call.index = end if again else end + 1

    def _expression(self, control: OWord, source: SourceLine) -> float:
        reader = ExpressionReader(source, control.rest, self._parameters)
        value = reader.expression()
        if reader.next:
            source.refuse(f"'{reader.code[reader.at :][:20]}' follows the expression of an O-word")
        return value

    def _call(self, control: OWord, source: SourceLine) -> None:
        reader, label = ExpressionReader(source, control.rest, self._parameters), control.label
        if not label:
            # The label of a call may be computed: o[#100] call.
            label = f"{round(reader.expression())}"
            if not reader.code.startswith("call", reader.at):
                source.refuse("an O-word with an expression can only be a call")
            reader.at += len("call")
        arguments = []
        while reader.next:
            arguments.append(reader.expression())
        if len(arguments) > _MOST_ARGUMENTS:
            source.refuse(f"a call has at most {_MOST_ARGUMENTS} arguments")
        section, begin = self._find(label, source)
        self._parameters.enter(arguments)
        self._enter(_Call(section, begin + 1, begin, label), source)

    def _enter(self, call: _Call, source: SourceLine) -> None:
        if len(self._calls) > _MOST_CALLS:
            source.refuse(f"subprograms call each other more than {_MOST_CALLS} deep")
        self._calls.append(call)

    def _return(self, control: OWord, source: SourceLine) -> None:
        if len(self._calls) < 2 or self._calls[-1].numbered:
            source.refuse("this line is not in a subroutine that was called by an O-word")
        self._system.returned = self._expression(control, source) if control.rest else None
        self._parameters.leave()
        self._calls.pop()

    def _call_numbered(self, statement: Statement) -> None:
        source = statement.source
        number, repeats = statement.value("P"), statement.value("L")
        if number is None or not (number.is_integer() and 0.0 <= number <= 9999.0):
            source.refuse("M98 needs the number of the subprogram, P0 to P9999")
        repeats = 1.0 if repeats is None else repeats
        if not repeats.is_integer() or repeats < 0.0:
            source.refuse(f"L is the number of repetitions, not {repeats:g}")
        if repeats:
            label = f"{int(number)}"
            section, begin = self._find_numbered(label, source)
            self._parameters.enter_shared()
            self._enter(_Call(section, begin + 1, begin, label, numbered=True, repeats=int(repeats) - 1), source)

    def _return_numbered(self, statement: Statement) -> None:
        source, call = statement.source, self._calls[-1]
        if statement.value("P") is not None:
            source.refuse("M99 with P jumps to a sequence number, which is not supported")
        if not call.numbered:
            source.refuse("M99 in the main program repeats it for ever", "End it with M2 or M30")
        if call.repeats:
            call.repeats -= 1
            call.index, call.counts = call.first + 1, {}
        else:
            self._parameters.leave()
            self._calls.pop()

    def _learn(self, section: ControlFlow) -> None:
        for label, begin in section.subroutines.items():
            self._known.setdefault(label, (section, begin))

    def _find(self, label: str, source: SourceLine) -> tuple[ControlFlow, int]:
        if label not in self._known:
            section = self._read_file(label, source)
            self._learn(section)
            if label not in self._known:
                source.refuse(f"the file {label}.ngc does not contain o<{label}> sub")
        return self._known[label]

    def _find_numbered(self, label: str, source: SourceLine) -> tuple[ControlFlow, int]:
        # A subprogram number belongs to its file: the file of the innermost call is searched first.
        for call in reversed(self._calls):
            if label in call.section.programs:
                return call.section, call.section.programs[label]
        section = self._read_file(label, source)
        if label not in section.programs:
            source.refuse(f"the file {label}.ngc does not contain the subprogram O{label}")
        return section, section.programs[label]

    def _read_file(self, label: str, source: SourceLine) -> ControlFlow:
        lines = self._files(label)
        if lines is None:
            message = f"the subprogram {label} is not in this program, and there is no file {label}.ngc beside it"
            source.refuse(message, "Copy it into the folder of the program")
        name = f"{label}.ngc"
        read = [SourceLine(number, text.rstrip("\r\n"), name) for number, text in enumerate(lines, start=1)]
        self._lines += len(read)
        return ControlFlow.of(read)
