"""Correction of a part program line by line, with memory use independent of its length."""

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
    """Pass the text of the corrected program to `emit`, in batches of some thousand lines, and return a summary.

    `lines` include their line ends; the output uses the line end of the first one. `name`: name of the table, which is
    written in the comment that marks the program as corrected; without a name there is no such comment. Raises
    FormatError naming the first line that cannot be corrected; the caller must then discard the output that `emit` has
    already received.
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
