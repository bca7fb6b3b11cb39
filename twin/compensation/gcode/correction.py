"""Correction of a part program line by line. The memory needed does not depend on the length of the program."""

from __future__ import annotations

from collections.abc import Callable, Iterable

from twin.compensation.gcode.correction_summary import CorrectionSummary
from twin.compensation.gcode.interpreter import MARK, Interpreter
from twin.compensation.gcode.modal import UNKNOWN, ModalState
from twin.compensation.gcode.setup import CorrectionOptions, PartSetup
from twin.compensation.gcode.writer import ProgramWriter
from twin.compensation.table import CompensationTable


def correct_program(
    lines: Iterable[str],
    table: CompensationTable,
    setup: PartSetup,
    options: CorrectionOptions,
    emit: Callable[[str], object],
    *,
    name: str = "",
) -> CorrectionSummary:
    """Correct a part program with a compensation table and return a summary of the correction.

    The text of the corrected program is passed to the function `emit` in batches of some thousand lines. Each element
    of `lines` includes its line end, and the output uses the line end of the first line. `name` is the name of the
    table. It is written in a comment that marks the program as corrected. If it is empty, no comment is written.

    Raises FormatError if a line cannot be corrected. The error names the first such line. The caller must then discard
    all output that `emit` has already received.
    """
    unit_mm = ModalState(setup).unit_mm
    writer = ProgramWriter(table, options, setup.start or UNKNOWN, unit_mm, emit)
    interpreter = Interpreter(setup, options, writer, f"({MARK}: {name})" if name else "")
    number = 0
    for number, line in enumerate(lines, start=1):
        if number == 1 and line.endswith("\r\n"):
            writer.newline = "\r\n"
        interpreter.feed(number, line.rstrip("\r\n"))
    writer.flush()
    writer.counts.lines = number
    return writer.counts
