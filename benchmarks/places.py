"""Output of benchmarks and campaigns: state directories in memory, rows in a CSV file."""

from __future__ import annotations

import csv
import os
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path

SHARED_MEMORY = "/dev/shm"  # noqa: S108  each benchmark creates its own directory inside


def memory_directory(name: str) -> tempfile.TemporaryDirectory[str]:
    """Return a temporary directory in memory, so that journal commits need no disk access; durability is tested
    elsewhere.
    """
    shared = SHARED_MEMORY if os.access(SHARED_MEMORY, os.W_OK) else None
    return tempfile.TemporaryDirectory(prefix=f"volcal-{name}-", dir=shared)


def write_csv(rows: Sequence[Mapping[str, object]], path: Path) -> None:
    """Write `rows` as CSV to `path`, with the keys of the first row as header."""
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, list(rows[0]), lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)
