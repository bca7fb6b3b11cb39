"""Whether the last run broke off, and whether it can be gone on with: asked of the journal, nothing is changed."""

from __future__ import annotations

import json
import sqlite3
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

from agent.execution.journal import FILE_NAME
from agent.execution.states import FINAL, RunState
from drivers.errors import InputError

RESUMABLE_FAULTS = frozenset(
    {"LinkError", "LinkLost", "LinkTimeout", "ProtocolError", "PermissionMissing", "JournalFailed", "Interrupted"}
)
"""Errors that came from outside the measurement: what was measured before them is as good as it was. After any other
fault something about machine, artefact or procedure is not as assumed."""

_LAST = (
    "SELECT run, run_id, kind, started, ended, state, coalesce(reason, '') FROM runs WHERE run IN "
    "(SELECT run FROM steps UNION SELECT run FROM origins WHERE begun_s IS NOT NULL) ORDER BY run DESC"
)
_LAST_OF_OLD = (
    "SELECT run, run_id, kind, started, ended, state, coalesce(reason, '') FROM runs WHERE run IN "
    "(SELECT run FROM steps) ORDER BY run DESC"
)
"""The last run that did anything: one that was refused before it began hides none that broke off."""


@dataclass(frozen=True)
class UnfinishedRun:
    """The last run of the journal that did anything, broken off.

    `refusal`: why it cannot be gone on with, empty where it can; `state`: the last one it entered; `started` UTC;
    `balls` centres that are kept; `last_step` the last that began.
    """

    run: int
    run_id: str
    kind: str
    started: str
    state: RunState
    reason: str
    balls: int
    last_step: str
    refusal: str

    @property
    def resumable(self) -> bool:
        return not self.refusal


def unfinished_run(state_directory: Path) -> UnfinishedRun | None:
    """The run that broke off and has not been followed by another; None where the last one came to an end of its own.

    To be asked by whoever owns the machine: a run that is under way looks just the same. InputError where the journal
    cannot be read.
    """
    path = state_directory / FILE_NAME
    if not path.is_file():
        return None
    try:
        with closing(sqlite3.connect(f"{path.resolve().as_uri()}?mode=ro", uri=True, timeout=2.0)) as connection:
            return _last(connection)
    except sqlite3.Error as error:
        raise InputError(f"the journal cannot be read: {error}", file=str(path)) from error


def _last(connection: sqlite3.Connection) -> UnfinishedRun | None:
    row = connection.execute(_LAST if _has_origins(connection) else _LAST_OF_OLD).fetchone()
    if row is None:
        return None
    run, run_id, kind, started, ended, state_name, reason = row
    state = RunState(state_name)
    fault = _fault(connection, run) if state is RunState.FAULTED else ""
    if ended is not None and fault not in RESUMABLE_FAULTS:
        return None
    refusal = _refusal(connection, run, state)
    balls = connection.execute("SELECT count(*) FROM balls WHERE run = ?", (run,)).fetchone()[0]
    return UnfinishedRun(run, run_id, kind, started, state, reason, balls, _last_step(connection, run), refusal)


def _refusal(connection: sqlite3.Connection, run: int, state: RunState) -> str:
    if state is RunState.ABORTING or (state in FINAL and state is not RunState.FAULTED):
        return f"it was {state.value}: somebody wanted it to end"
    if not _has_origins(connection):
        return "it was written by an older version, which kept too little of how it began"
    begun = connection.execute("SELECT begun_s FROM origins WHERE run = ?", (run,)).fetchone()
    if begun is None or begun[0] is None:
        return "it had not begun to measure; start it again"
    return ""


def _has_origins(connection: sqlite3.Connection) -> bool:
    return connection.execute("SELECT 1 FROM sqlite_master WHERE name = 'origins'").fetchone() is not None


def _fault(connection: sqlite3.Connection, run: int) -> str:
    """Class of the error that ended the run: the first fault since it began or was last gone on with."""
    rows = connection.execute(
        "SELECT kind, record FROM events WHERE run = ? AND kind IN ('fault', 'state') ORDER BY rowid", (run,)
    ).fetchall()
    first = ""
    for kind, text in rows:
        record = json.loads(text)
        if kind == "state" and record["state"] == RunState.RESUMING.value:
            first = ""
        elif kind == "fault" and not first:
            first = str(record["type"])
    return first


def _last_step(connection: sqlite3.Connection, run: int) -> str:
    row = connection.execute("SELECT key FROM steps WHERE run = ? ORDER BY ordinal DESC LIMIT 1", (run,)).fetchone()
    return "" if row is None else str(row[0])
