"""Correction of part programs by a table from a file. The corrected program is written completely or not at all."""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO, TextIO

from agent.files import read_text, streamed_atomically, translated
from drivers.errors import InputError
from gcode.correction import correct_program
from gcode.correction_summary import CorrectionSummary
from gcode.setup import CorrectionOptions, PartSetup
from gcode.setup_file import parse_part_setup
from twin.compensation.table import CompensationTable
from twin.compensation.table_file import checksum, parse_table

SUBPROGRAM_SUFFIX = ".ngc"


def load_table(path: Path) -> tuple[CompensationTable, str]:
    """Return two values: the table stored in a CSV file and in the JSON file beside it, and the CRC-32 of the CSV
    file."""
    side = path.with_suffix(".json")
    text = read_text(path)
    with translated(InputError, file=str(path)):
        return parse_table(text, read_text(side), str(path), str(side)), checksum(text)


def load_part_setup(path: Path) -> PartSetup:
    text = read_text(path)
    with translated(InputError, file=str(path)):
        return parse_part_setup(text, str(path))


def correct_file(
    part: Path, out: Path | None, table: CompensationTable, name: str, setup: PartSetup, options: CorrectionOptions
) -> CorrectionSummary:
    """Correct the part program `part` and write the result to `out`. If `out` is None, only compute the summary of the
    correction, which is returned in both cases.

    `name` is the name of the table; it is written into the corrected program. Raises InputError if a block (line of the
    program) cannot be corrected. The error names the file and the line, and `out` is not changed in this case.
    """
    if out is not None and out.resolve() == part.resolve():
        message = "the corrected program would replace the original program"
        raise InputError(message, hint="write it to another file", file=str(out))

    def subprogram(wanted: str) -> list[str] | None:
        """Return the lines of a subprogram in the folder of the part program, or None if there is no such file."""
        file = part.parent / f"{wanted}{SUBPROGRAM_SUFFIX}"
        if Path(wanted).name != wanted or not file.is_file():
            return None
        with _open_program(file) as lines:
            return list(lines)

    with _open_program(part) as source, translated(InputError, file=str(part)):
        if out is None:
            return correct_program(source, table, setup, options, lambda _: None, name=name, files=subprogram)
        with streamed_atomically(out) as target:
            return correct_program(source, table, setup, options, target.write, name=name, files=subprogram)


def correct_to(
    stream: BinaryIO, part: Path, table: CompensationTable, name: str, setup: PartSetup, options: CorrectionOptions
) -> CorrectionSummary:
    """Correct the part program `part` and write the result to `stream`. Writing starts only after the whole program has
    been corrected.

    Raises the errors that `correct_file` raises.
    """
    with tempfile.TemporaryDirectory() as folder:
        corrected = Path(folder) / "corrected"
        summary = correct_file(part, corrected, table, name, setup, options)
        with corrected.open("rb") as source:
            shutil.copyfileobj(source, stream)
    return summary


@contextmanager
def _open_program(part: Path) -> Iterator[TextIO]:
    try:
        with part.open(encoding="utf-8", errors="surrogateescape", newline="") as file:
            yield file
    except FileNotFoundError:
        raise InputError("there is no such file", hint="check the path", file=str(part)) from None
    except IsADirectoryError:
        raise InputError("this is a directory, a file is needed", file=str(part)) from None
    except PermissionError:
        raise InputError("the file cannot be read: permission denied", file=str(part)) from None
