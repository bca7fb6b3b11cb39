"""A part program from a file, corrected with a table from files, into a file: all of it or nothing."""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO, TextIO

from agent.files import read_text, streamed_atomically, translated
from drivers.errors import InputError
from twin.compensation.gcode.correction import correct_program
from twin.compensation.gcode.correction_summary import CorrectionSummary
from twin.compensation.gcode.setup import CorrectionOptions, PartSetup
from twin.compensation.part_setup_file import parse_part_setup
from twin.compensation.table import CompensationTable
from twin.compensation.table_file import checksum, parse_table


def load_table(path: Path) -> tuple[CompensationTable, str]:
    """The table of a CSV file and the JSON file beside it, and its CRC-32."""
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
    """Write the corrected program to `out`, or nothing to it where it is None; `name` marks it.

    Raises InputError with file and line for what cannot be corrected; what stood in `out` then stands there still.
    """
    if out is not None and out.resolve() == part.resolve():
        message = "the corrected program would replace the program as it was made"
        raise InputError(message, hint="write it to another file", file=str(out))
    with _opened(part) as source, translated(InputError, file=str(part)):
        if out is None:
            return correct_program(source, table, setup, options, lambda _: None, name=name)
        with streamed_atomically(out) as target:
            return correct_program(source, table, setup, options, target.write, name=name)


def correct_to(
    stream: BinaryIO, part: Path, table: CompensationTable, name: str, setup: PartSetup, options: CorrectionOptions
) -> CorrectionSummary:
    """The same to a stream, which gets nothing before all is corrected."""
    with tempfile.TemporaryDirectory() as folder:
        whole = Path(folder) / "corrected"
        counts = correct_file(part, whole, table, name, setup, options)
        with whole.open("rb") as source:
            shutil.copyfileobj(source, stream)
    return counts


@contextmanager
def _opened(part: Path) -> Iterator[TextIO]:
    try:
        with part.open(encoding="utf-8", errors="surrogateescape", newline="") as file:
            yield file
    except FileNotFoundError:
        raise InputError("there is no such file", hint="check the path", file=str(part)) from None
    except IsADirectoryError:
        raise InputError("this is a directory, a file is needed", file=str(part)) from None
    except PermissionError:
        raise InputError("the file may not be read", file=str(part)) from None
