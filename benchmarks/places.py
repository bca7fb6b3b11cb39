"""Places for the output of benchmarks and campaigns: state directories in memory, and rows in a CSV file."""

from __future__ import annotations

import csv
import os
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path

SHARED_MEMORY = "/dev/shm"  # noqa: S108  each benchmark creates its own directory inside


def memory_directory(name: str) -> tempfile.TemporaryDirectory[str]:
    """Return a temporary directory in memory, where database commits of the run journal need no disk access.

    The durability of the journal is tested elsewhere, without this directory. If the system has no directory in memory,
    the directory is on disk.
    """
    return tempfile.TemporaryDirectory(prefix=f"volcal-{name}-", dir=memory_root())


def memory_root() -> str | None:
    """Return the directory in memory in which every user may make directories; None if the system has none."""
    return SHARED_MEMORY if os.access(SHARED_MEMORY, os.W_OK) else None


def write_csv(rows: Sequence[Mapping[str, object]], path: Path) -> None:
    """Write `rows` as CSV to `path`. The keys of the first row are the header."""
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, list(rows[0]), lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)
