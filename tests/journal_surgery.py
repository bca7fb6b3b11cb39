"""Changes to a journal that the program never makes, for tests of other versions, other days and damage.

The only SQL on the journal outside its own modules.
"""

from __future__ import annotations

import sqlite3
from contextlib import closing
from pathlib import Path

from agent.execution.journal_schema import FILE_NAME


def operate(state: Path, statement: str, *values: object) -> None:
    """Carry out one statement on the journal of a state directory."""
    with closing(sqlite3.connect(state / FILE_NAME)) as connection, connection:
        connection.execute(statement, values)


def change_dates(state: Path, run_id: str, started: str, ended: str) -> None:
    """UTC, ISO 8601."""
    operate(state, "UPDATE runs SET started = ?, ended = ? WHERE run_id = ?", started, ended, run_id)


def change_start_of_measuring(state: Path, run: int, begun_at: str) -> None:
    """UTC, ISO 8601."""
    operate(state, "UPDATE origins SET begun_at = ? WHERE run = ?", begun_at, run)


def change_end(state: Path, final_state: str, reason: str) -> None:
    """Overwrite the final state and the reason of every run."""
    operate(state, "UPDATE runs SET state = ?, reason = ?", final_state, reason)


def add_event(state: Path, run: int, kind: str, record_text: str) -> None:
    operate(state, "INSERT INTO events (run, at, kind, record) VALUES (?, '', ?, ?)", run, kind, record_text)


def rename_steps(state: Path, pattern: str, key: str) -> None:
    """`pattern`: of SQL's LIKE."""
    operate(state, "UPDATE steps SET key = ? WHERE key LIKE ?", key, pattern)


def remove_results(state: Path) -> None:
    """Delete every estimate and decision."""
    operate(state, "DELETE FROM estimates")
    operate(state, "DELETE FROM decisions")


def is_intact(state: Path) -> bool:
    """SQLite's own check of the whole file."""
    with closing(sqlite3.connect(state / FILE_NAME)) as connection:
        return bool(connection.execute("PRAGMA integrity_check").fetchall() == [("ok",)])
