"""Retention of finished runs: old runs are compacted, so that the state directory grows less. Nothing is deleted.

The journal has the records of the run in packed form afterwards, and the estimate file in the folder of the run is
compressed. Reports, history and commands read both as before. The folder is compacted first: if the power fails in
between, the run is still listed as whole, and the next compaction does what is missing.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from datetime import datetime, timedelta
from pathlib import Path

from agent.execution.journal_compaction import compactable_runs, packed_record, store_packed
from agent.execution.journal_rows import RunRow
from agent.files import write_all_atomically
from agent.settings.history import HistorySettings
from drivers.errors import InputError
from drivers.foreign_errors import cause_of
from twin.formats.compressed_text import MAX_TEXT_BYTES, SUFFIX, compress_text

FILES = ("estimate.json",)
"""Result files that are compressed. The others are small, or people open them."""


@dataclass(frozen=True)
class Compaction:
    """Space in bytes that the records and files of the run `run_id` take before and after they are compacted."""

    run_id: str
    kind: str
    before_bytes: int
    after_bytes: int


def due_runs(directory: Path, settings: HistorySettings, now: datetime) -> tuple[RunRow, ...]:
    """Return the runs of the state directory `directory` that are to be compacted according to `settings` at the time
    `now`, in the order in which they started. Raises JournalFailed if the journal cannot be read."""
    if not settings.compact:
        return ()
    return compactable_runs(directory, settings.whole_runs, now - timedelta(days=settings.whole_days))


def compact(directory: Path, row: RunRow, *, write: bool) -> Compaction | None:
    """Compact a run of the state directory `directory`, or only find what that would save if `write` is False.

    Return None if the run is left as it is, because its records are damaged or too long. The caller holds the lock on
    the machine if `write` is True. Raises JournalFailed or InputError if the journal or the folder of the run cannot be
    read or written; the run is then still complete.
    """
    record = packed_record(directory, row.run)
    if record is None:
        return None
    folder = directory / row.run_id
    before, after = record.before_bytes, record.after_bytes
    for name, text, content in _compressed(folder):
        before, after = before + len(text), after + len(content)
        if write:
            write_all_atomically(folder, {name + SUFFIX: content}, removed=[name])
    if write:
        store_packed(directory, record)
    return Compaction(row.run_id, row.kind, before, after)


def _compressed(folder: Path) -> Iterator[tuple[str, bytes, bytes]]:
    """Yield the name, the content and the compressed content of each file that is not compressed yet. Raises InputError
    if a file cannot be read."""
    for name in FILES:
        path = folder / name
        if path.is_file() and not path.is_symlink() and path.stat().st_size <= MAX_TEXT_BYTES:
            text = _content(path)
            yield name, text, compress_text(text)


def _content(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except OSError as error:
        raise InputError(f"the file cannot be read: {cause_of(error)}", file=str(path)) from error
