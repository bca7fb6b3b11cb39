"""Tables of the campaign in the documents: CSV with one row per machine or hour."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping, Sequence
from pathlib import Path

from agent.files import write_atomically


def write_rows(path: Path, rows: Sequence[Mapping[str, str]]) -> None:
    """Write rows with the same columns into a file."""
    text = io.StringIO()
    writer = csv.DictWriter(text, list(rows[0]), lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    write_atomically(path, text.getvalue())


def read_rows(path: Path) -> list[dict[str, str]]:
    """Return the rows of a file."""
    return list(csv.DictReader(path.read_text(encoding="utf-8").splitlines()))
