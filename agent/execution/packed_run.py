"""Packed form of the records of a finished run: its steps, balls and temperatures in one compressed text, and its
estimates as compressed texts."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Self

from agent.execution.journal_queries import PACKED_COLUMNS
from agent.execution.stored_json import HINT
from drivers.errors import InputError
from twin.errors import FormatError
from twin.formats.compressed_text import expand_text


@dataclass(frozen=True)
class PackedRun:
    """Rows of the steps, balls and temperatures of a run by the name of their table, with the columns
    `PACKED_COLUMNS`."""

    rows: Mapping[str, Sequence[Sequence[Any]]]

    @property
    def text(self) -> bytes:
        """Rows as JSON text, in which numbers keep every bit."""
        return json.dumps(self.rows, separators=(",", ":"), ensure_ascii=False, allow_nan=False).encode()

    @classmethod
    def unpacked(cls, content: bytes) -> Self:
        """Return the rows of the packed form `content`. Raises InputError if it is damaged, or if its text is longer
        than that of any run that was compacted."""
        try:
            document = json.loads(_expanded(content))
            rows = {table: [list(row) for row in document[table]] for table in PACKED_COLUMNS}
        except (ValueError, LookupError, TypeError, RecursionError) as error:
            raise _damaged(error) from error
        for table, columns in PACKED_COLUMNS.items():
            width = len(columns.split(", "))
            if any(len(row) != width for row in rows[table]):
                raise _damaged(f"a row of {table} is not complete")
        return cls(rows)

    @property
    def balls(self) -> int:
        return len(self.rows["balls"])

    @property
    def touches(self) -> int:
        """Number of touches with a result, including those that are not part of the procedure."""
        kind, result = (PACKED_COLUMNS["steps"].split(", ").index(name) for name in ("kind", "result"))
        return sum(row[kind] == "TouchTowards" and row[result] is not None for row in self.rows["steps"])


def expand_stored_text(stored: str | bytes) -> str:
    """Return a text of the journal that is stored as it is or in packed form. Raises InputError if the packed form is
    damaged."""
    if isinstance(stored, str):
        return stored
    try:
        return _expanded(stored).decode()
    except (ValueError, TypeError) as error:
        raise _damaged(error) from error


def _expanded(content: bytes) -> bytes:
    try:
        return expand_text(content)
    except FormatError as error:
        raise _damaged(error.message) from error


def _damaged(reason: object) -> InputError:
    return InputError(f"the journal is damaged: the record of a compacted run cannot be read ({reason})", hint=HINT)
