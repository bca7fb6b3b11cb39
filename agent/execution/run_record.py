"""A whole run as the journal has it, for history and reports. Nothing is created and nothing is changed."""

from __future__ import annotations

import json
import sqlite3
from collections.abc import Iterator, Mapping
from contextlib import closing, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from agent.execution.journal import FILE_NAME
from drivers.errors import InputError

S_PER_MIN = 60.0


@dataclass(frozen=True)
class Note:
    """One event or decision, `at` UTC."""

    at: str
    kind: str
    record: Mapping[str, Any]


@dataclass(frozen=True)
class Question:
    """What a person was asked, minutes of machine time after the first step; `answered`: the answer was yes."""

    minute: float
    text: str
    answered: bool
    error: str


@dataclass(frozen=True)
class KeptTable:
    """`role`: backup, staged, restored; `crc32` None where the bank held nothing."""

    role: str
    bank: int
    crc32: int | None


@dataclass(frozen=True)
class RunRecord:
    """`settings_text`: as it stands in the journal. `estimate`: the last one's text. `temperatures`: minutes after the
    first step, names to °C. `balls`, `touches`: how many there are. `ordinal`: counts the runs of this journal."""

    ordinal: int
    run_id: str
    kind: str
    started: str
    ended: str | None
    state: str
    reason: str
    software: str
    settings_text: str
    decisions: tuple[Note, ...]
    events: tuple[Note, ...]
    questions: tuple[Question, ...]
    tables: tuple[KeptTable, ...]
    temperatures: tuple[tuple[float, Mapping[str, float]], ...]
    estimate: str | None
    balls: int
    touches: int
    minutes: float

    @property
    def settings(self) -> Mapping[str, Any]:
        document: dict[str, Any] = json.loads(self.settings_text)
        return document

    def decision(self, kind: str) -> Mapping[str, Any] | None:
        """The last decision of that kind."""
        found = [note.record for note in self.decisions if note.kind == kind]
        return found[-1] if found else None

    def event(self, kind: str) -> Mapping[str, Any] | None:
        found = [note.record for note in self.events if note.kind == kind]
        return found[-1] if found else None

    def table(self, role: str) -> KeptTable | None:
        found = [table for table in self.tables if table.role == role]
        return found[-1] if found else None


def run_ids(directory: Path) -> tuple[str, ...]:
    """Of all runs of the journal in the state directory, in the order in which they began. InputError as `read_run`."""
    with _opened(directory) as connection:
        return tuple(run_id for (run_id,) in connection.execute("SELECT run_id FROM runs ORDER BY run"))


def read_record(directory: Path, run_id: str) -> RunRecord:
    """InputError where there is no such journal or run, or where the journal cannot be read."""
    with _opened(directory) as connection:
        row = connection.execute(
            "SELECT run, run_id, kind, started, ended, state, coalesce(reason, ''), software, settings "
            "FROM runs WHERE run_id = ?",
            (run_id,),
        ).fetchone()
        if row is None:
            raise _unknown(connection, directory, run_id)
        return _record(connection, row)


def _unknown(connection: sqlite3.Connection, directory: Path, run_id: str) -> InputError:
    known = [name for (name,) in connection.execute("SELECT run_id FROM runs ORDER BY run DESC LIMIT 3")]
    hint = f"the last ones are: {', '.join(known)}" if known else "it has no run yet"
    return InputError(f"the journal has no run {run_id}", file=str(directory / FILE_NAME), hint=hint)


def _record(connection: sqlite3.Connection, row: tuple[Any, ...]) -> RunRecord:
    """`row`: the first nine fields of the record, as the query above has them."""
    run, run_id, kind, started, ended, state, reason, software, settings = row

    def all_of(query: str) -> list[Any]:
        return connection.execute(query, {"run": run}).fetchall()

    first, last = all_of("SELECT min(begun), max(coalesce(finished, begun)) FROM steps WHERE run = :run")[0]
    estimates = all_of("SELECT record FROM estimates WHERE run = :run ORDER BY rowid DESC LIMIT 1")
    return RunRecord(
        ordinal=run,
        run_id=run_id,
        kind=kind,
        started=started,
        ended=ended,
        state=state,
        reason=reason,
        software=software,
        settings_text=settings,
        decisions=_notes(all_of("SELECT at, kind, record FROM decisions WHERE run = :run ORDER BY rowid")),
        events=_notes(all_of("SELECT at, kind, record FROM events WHERE run = :run ORDER BY rowid")),
        questions=tuple(
            _question(first, *step)
            for step in all_of(
                "SELECT begun, detail, finished, error FROM steps WHERE run = :run AND kind = 'AskOperator' "
                "ORDER BY ordinal"
            )
        ),
        tables=tuple(
            KeptTable(*values)
            for values in all_of("SELECT role, bank, crc32 FROM tables WHERE run = :run ORDER BY rowid")
        ),
        temperatures=tuple(
            ((finished - first) / S_PER_MIN, json.loads(record))
            for finished, record in all_of(
                "SELECT finished, record FROM temperatures JOIN steps USING (run, ordinal) WHERE run = :run "
                "ORDER BY ordinal"
            )
        ),
        estimate=estimates[0][0] if estimates else None,
        balls=all_of("SELECT count(*) FROM balls WHERE run = :run")[0][0],
        touches=all_of("SELECT count(*) FROM touches WHERE run = :run")[0][0],
        minutes=0.0 if first is None else (last - first) / S_PER_MIN,
    )


def _notes(rows: list[tuple[str, str, str]]) -> tuple[Note, ...]:
    return tuple(Note(at, kind, json.loads(record)) for at, kind, record in rows)


def _question(first: float, begun: float, detail: str, finished: float | None, error: str | None) -> Question:
    text = json.loads(detail)["request"]["text"]
    return Question((begun - first) / S_PER_MIN, text, finished is not None, error or "")


@contextmanager
def _opened(directory: Path) -> Iterator[sqlite3.Connection]:
    path = directory / FILE_NAME
    if not path.is_file():
        raise InputError("there is no journal", file=str(path), hint="check `state_directory`: no run has begun there")
    try:
        with closing(sqlite3.connect(f"{path.resolve().as_uri()}?mode=ro", uri=True, timeout=2.0)) as connection:
            yield connection
    except sqlite3.Error as error:
        raise InputError(f"the journal cannot be read: {error}", file=str(path)) from error
