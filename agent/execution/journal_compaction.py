"""Compaction of finished runs in the journal. A compacted run takes about a third of the space and reads as before.

The steps, balls and temperatures of the run become one compressed text, and each of its estimates becomes one. The run
itself, its events, decisions and compensation tables are left as they were written. One transaction replaces the
records of one run, so a power cut leaves the run whole or compacted. The space becomes free inside the file, and later
runs are written into it.
"""

from __future__ import annotations

import sqlite3
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path

from agent.errors import JournalFailed
from agent.execution.journal_queries import PACKED_COLUMNS
from agent.execution.journal_reader import connected, has_journal, open_journal
from agent.execution.journal_rows import RunRow
from agent.execution.journal_schema import FILE_NAME, VERSION, prepare
from agent.execution.packed_run import PackedRun
from agent.execution.states import FINAL, RunState
from drivers.foreign_errors import cause_of
from twin.formats.compressed_text import MAX_TEXT_BYTES, compress_text

_HINT = "check the disk under `state_directory`; no run in the journal was changed by this"


@dataclass(frozen=True)
class PackedRecord:
    """Records of the run number `run` in packed form, ready to be stored.

    `content` replaces its steps, balls and temperatures, of which there are `rows`, and `estimates` replace its
    estimates, by their row number. `before_bytes` is the length of what is replaced.
    """

    run: int
    balls: int
    touches: int
    rows: int
    content: bytes
    estimates: tuple[tuple[int, bytes], ...]
    before_bytes: int

    @property
    def after_bytes(self) -> int:
        return len(self.content) + sum(len(text) for _, text in self.estimates)


def compactable_runs(directory: Path, whole_runs: int, ended_before: datetime) -> tuple[RunRow, ...]:
    """Return the runs of the journal in the state directory `directory` that may be compacted, in the order in which
    they started.

    These are runs that have ended before the UTC time `ended_before`, except the latest `whole_runs` runs, the last run
    that has measured or written tables with all later ones, since it may be resumed, and the last run that has read the
    compensation, with which the controller is compared. Raises JournalFailed if the journal cannot be read.
    """
    if not has_journal(directory):
        return ()
    with open_journal(directory, JournalFailed) as reader:
        runs, compacted = reader.runs(), reader.compacted_runs()
        worked = next((row.run for row in reader.latest_begun_runs() if reader.has_worked(row.run)), None)
        backup = reader.last_backup()
        if worked is None:
            return ()
        return tuple(
            row
            for row in runs[: max(len(runs) - whole_runs, 0)]
            if row.run not in compacted
            and row.run < worked
            and (backup is None or row.run != backup.run)
            and _ended_before(row, ended_before)
        )


def _ended_before(row: RunRow, time: datetime) -> bool:
    return row.ended is not None and RunState(row.state) in FINAL and datetime.fromisoformat(row.ended) < time


def packed_record(directory: Path, run: int) -> PackedRecord | None:
    """Return the records of the run number `run` in packed form; nothing is written. Return None if they are too long
    to be packed, or damaged. Raises JournalFailed if the journal cannot be read."""
    try:
        with _connected(directory, "mode=ro") as connection:
            connection.text_factory = bytes.decode  # a text that is not UTF-8 is then a ValueError
            packed = PackedRun(
                {
                    table: connection.execute(
                        f"SELECT {columns} FROM {table} WHERE run = ? ORDER BY ordinal",  # noqa: S608  our own names
                        (run,),
                    ).fetchall()
                    for table, columns in PACKED_COLUMNS.items()
                }
            )
            stored = connection.execute("SELECT rowid, record FROM estimates WHERE run = ?", (run,)).fetchall()
        texts = [packed.text, *(str.encode(record) for _, record in stored)]
    except (TypeError, ValueError):
        return None
    if max(map(len, texts)) > MAX_TEXT_BYTES:
        return None
    content, *estimates = map(compress_text, texts)
    return PackedRecord(
        run=run,
        balls=packed.balls,
        touches=packed.touches,
        rows=sum(len(one) for one in packed.rows.values()),
        content=content,
        estimates=tuple((number, text) for (number, _), text in zip(stored, estimates, strict=True)),
        before_bytes=sum(map(len, texts)),
    )


def store_packed(directory: Path, record: PackedRecord) -> None:
    """Replace the records of a run in the journal by their packed form, durably and in one transaction.

    The caller holds the lock on the machine, so that no run is being written. Raises JournalFailed if the journal
    cannot be written, or if the run has been changed since it was packed; the journal is then unchanged.
    """
    with _connected(directory, "mode=rw") as connection:
        prepare(connection, directory / FILE_NAME)
        connection.execute("BEGIN IMMEDIATE")
        try:
            _replace(connection, record)
        except BaseException:
            if connection.in_transaction:  # SQLite rolls back on its own if the disk is full
                connection.execute("ROLLBACK")
            raise
        connection.execute("COMMIT")


def _replace(connection: sqlite3.Connection, record: PackedRecord) -> None:
    connection.execute(
        "INSERT INTO compacted_runs VALUES (?,?,?,?)", (record.run, record.balls, record.touches, record.content)
    )
    rows = sum(
        connection.execute(f"DELETE FROM {table} WHERE run = ?", (record.run,)).rowcount  # noqa: S608  our own names
        for table in PACKED_COLUMNS
    )
    estimates = [
        connection.execute("UPDATE estimates SET record = ? WHERE rowid = ? AND run = ?", (text, number, record.run))
        for number, text in record.estimates
    ]
    [(kept,)] = connection.execute("SELECT count(*) FROM estimates WHERE run = ?", (record.run,))
    if rows != record.rows or kept != len(estimates):
        raise JournalFailed(f"run number {record.run} was changed while it was compacted", hint="try again")
    connection.execute(f"PRAGMA user_version = {VERSION}")


def journal_bytes(directory: Path) -> int:
    """Return the size of the journal with its write-ahead log in bytes; 0 if there is none."""
    paths = (directory / FILE_NAME, directory / f"{FILE_NAME}-wal")
    return sum(path.stat().st_size for path in paths if path.is_file())


def release_space(directory: Path) -> None:
    """Give the free space inside the journal file back to the file system, if it has any. For a time this needs free
    space of about the size of the journal. Raises JournalFailed, with the journal unchanged, if the disk is full."""
    with _connected(directory, "mode=rw") as connection:
        prepare(connection, directory / FILE_NAME)
        [(free_pages,)] = connection.execute("PRAGMA freelist_count")
        if free_pages:
            connection.execute("VACUUM")
            connection.execute("PRAGMA wal_checkpoint(TRUNCATE)")


@contextmanager
def _connected(directory: Path, option: str) -> Iterator[sqlite3.Connection]:
    path = directory / FILE_NAME
    try:
        with connected(path, option) as connection:
            connection.isolation_level = None
            yield connection
    except sqlite3.Error as error:
        raise JournalFailed(
            f"the journal cannot be compacted: {cause_of(error)}", hint=_HINT, file=str(path)
        ) from error
