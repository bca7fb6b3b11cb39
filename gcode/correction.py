"""Correction of a part program line by line. The memory needed does not depend on the length of the program."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator

from gcode.correction_summary import CorrectionSummary
from gcode.flattening.flattener import Flattener, SubprogramFiles
from gcode.interpreter import MARK, Interpreter
from gcode.modal import UNKNOWN, ModalState
from gcode.setup import CorrectionOptions, PartSetup
from gcode.writer import ProgramWriter
from twin.compensation.table import CompensationTable


def correct_program(
    lines: Iterable[str],
    table: CompensationTable,
    setup: PartSetup,
    options: CorrectionOptions,
    emit: Callable[[str], object],
    *,
    name: str = "",
    files: SubprogramFiles = lambda _: None,
) -> CorrectionSummary:
    """Correct a part program with a compensation table and return a summary of the correction.

    The text of the corrected program is passed to the function `emit` in batches of some thousand lines. Each element
    of `lines` includes its line end, and the output uses the line end of the first line. `name` is the name of the
    table. It is written in a comment that marks the program as corrected. If it is empty, no comment is written.
    `files` finds subprograms that are not in the program.

    Raises FormatError if a line cannot be corrected. The error names the first such line. The caller must then discard
    all output that `emit` has already received.
    """
    unit_mm = ModalState(setup).unit_mm
    writer = ProgramWriter(table, options, setup.start or UNKNOWN, unit_mm, emit)
    interpreter = Interpreter(setup, options, writer, f"({MARK}: {name})" if name else "")
    counted = _Counted(lines, writer)
    flattener = Flattener(interpreter.modal, setup.parameters, files)
    for block in flattener.blocks(counted):
        interpreter.feed(block.source, block.text)
    writer.flush()
    writer.counts.lines = counted.number
    return writer.counts


class _Counted:
    """Lines of a part program that are counted while they are read. The line end of the first one is passed on."""

    def __init__(self, lines: Iterable[str], writer: ProgramWriter) -> None:
        self.number = 0
        self._lines = lines
        self._writer = writer

    def __iter__(self) -> Iterator[str]:
        for line in self._lines:
            self.number += 1
            if self.number == 1 and line.endswith("\r\n"):
                self._writer.newline = "\r\n"
            yield line
