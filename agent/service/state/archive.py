"""The journal as the doors read it: rows to plain documents, through connections that never hinder the run."""

from __future__ import annotations

import json
import sqlite3
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from agent.errors import JournalFailed
from agent.execution.journal import FILE_NAME
from drivers.errors import InputError

Document = dict[str, Any]

_RUNS = (
    "SELECT run_id, kind, started, ended, state, reason, software, "
    "(SELECT count(*) FROM balls WHERE balls.run = runs.run), "
    "(SELECT count(*) FROM steps WHERE steps.run = runs.run AND kind = 'TouchTowards' AND result IS NOT NULL) "
    "FROM runs "
)
_RUN_FIELDS = ("run_id", "kind", "started", "ended", "state", "reason", "software", "balls", "touches")
_TABLE_FIELDS = ("run_id", "at", "role", "bank", "crc32", "origin_mm", "step_mm", "resolution_mm", "shape")


class UnknownRun(InputError):
    """No run of that identity in the journal."""


@dataclass(frozen=True)
class Archive:
    """`directory`: the state directory; `reports` finds or makes the file of a report."""

    directory: Path
    reports: Callable[[str], Path]

    def runs(self, limit: int, before: str | None = None) -> list[Document]:
        """The latest first; `before`: only those begun before that run."""
        if not self._begun:
            return []
        where = "WHERE run < (SELECT run FROM runs WHERE run_id = ?) " if before else ""
        values = (before, limit) if before else (limit,)
        with self._reading() as connection:
            if before:
                self._number(connection, before)
            rows = connection.execute(f"{_RUNS}{where}ORDER BY run DESC LIMIT ?", values).fetchall()
        return [self._summary(row) for row in rows]

    def run(self, run_id: str) -> Document:
        """Summary, who asked for it, gates and decisions."""
        with self._reading() as connection:
            run = self._number(connection, run_id)
            row = connection.execute(f"{_RUNS}WHERE run = ?", (run,)).fetchone()
            settings = json.loads(connection.execute("SELECT settings FROM runs WHERE run = ?", (run,)).fetchone()[0])
            decisions = _records(connection, "SELECT at, kind, record FROM decisions WHERE run = ? ORDER BY rowid", run)
            asked = _records(connection, "SELECT at, kind, record FROM events WHERE run = ? AND kind = 'asked'", run)
        return {
            **self._summary(row),
            "position_set": settings["procedure"]["position_set"],
            "asked": asked[0]["record"] if asked else None,
            "gates": [one["record"] for one in decisions if one["kind"] == "gate"],
            "decisions": [one for one in decisions if one["kind"] not in ("gate", "accepted")],
            "accepted": any(one["kind"] == "accepted" for one in decisions),
        }

    def balls(self, run_id: str) -> list[Document]:
        return self._keyed("SELECT key, record FROM balls WHERE run = ? ORDER BY ordinal", run_id)

    def temperatures(self, run_id: str) -> list[Document]:
        """`minutes` of machine time since the run's first step."""
        query = (
            "SELECT (finished - (SELECT min(begun) FROM steps WHERE run = ?1)) / 60.0, record "
            "FROM temperatures JOIN steps USING (run, ordinal) WHERE run = ?1 ORDER BY ordinal"
        )
        with self._reading() as connection:
            rows = connection.execute(query, (self._number(connection, run_id),)).fetchall()
        return [{"minutes": minutes, "celsius": json.loads(record)} for minutes, record in rows]

    def events(self, run_id: str, limit: int, after: int = 0) -> list[Document]:
        """In the order that they happened; `after`: the number of the last one that is known already."""
        query = "SELECT rowid, at, kind, record FROM events WHERE run = ? AND rowid > ? ORDER BY rowid LIMIT ?"
        with self._reading() as connection:
            rows = connection.execute(query, (self._number(connection, run_id), after, limit)).fetchall()
        return [{"number": n, "at": at, "kind": kind, "record": json.loads(record)} for n, at, kind, record in rows]

    def estimate(self, run_id: str) -> Document:
        """The estimate file's document. UnknownRun where the run did not come to one."""
        with self._reading() as connection:
            run = self._number(connection, run_id)
            row = connection.execute(
                "SELECT record FROM estimates WHERE run = ? ORDER BY rowid DESC LIMIT 1", (run,)
            ).fetchone()
        if row is None:
            raise UnknownRun(f"run {run_id} has no estimate", hint="it ended before its errors were identified")
        document: Document = json.loads(row[0])
        return document

    def report(self, run_id: str) -> Path:
        """The report's file. UnknownRun where there is none; InputError where it cannot be made."""
        with self._reading() as connection:
            run = self._number(connection, run_id)
            (ended,) = connection.execute("SELECT ended FROM runs WHERE run = ?", (run,)).fetchone()
        if ended is None:
            raise UnknownRun(f"run {run_id} has no report yet", hint="it has not ended")
        return self.reports(run_id)

    def tables(self, limit: int) -> list[Document]:
        """Every table that was kept, the latest first: backups, staged and restored ones."""
        if not self._begun:
            return []
        query = (
            "SELECT run_id, at, role, bank, crc32, origin_mm, step_mm, resolution_mm, shape "
            "FROM tables JOIN runs USING (run) ORDER BY tables.rowid DESC LIMIT ?"
        )
        with self._reading() as connection:
            rows = connection.execute(query, (limit,)).fetchall()
        return [_table(dict(zip(_TABLE_FIELDS, row, strict=True))) for row in rows]

    def _summary(self, row: tuple[Any, ...]) -> Document:
        document = dict(zip(_RUN_FIELDS, row, strict=True))
        return {**document, "report": (self.directory / document["run_id"] / "report.html").is_file()}

    def _keyed(self, query: str, run_id: str) -> list[Document]:
        with self._reading() as connection:
            rows = connection.execute(query, (self._number(connection, run_id),)).fetchall()
        return [{"key": key, **json.loads(record)} for key, record in rows]

    @staticmethod
    def _number(connection: sqlite3.Connection, run_id: str) -> int:
        row = connection.execute("SELECT run FROM runs WHERE run_id = ?", (run_id,)).fetchone()
        if row is None:
            raise UnknownRun(f"the journal has no run {run_id}", hint="`/api/runs` lists them")
        return int(row[0])

    @property
    def _begun(self) -> bool:
        """There is no journal before the first run."""
        return (self.directory / FILE_NAME).is_file()

    @contextmanager
    def _reading(self) -> Iterator[sqlite3.Connection]:
        path = self.directory / FILE_NAME
        try:
            with closing(sqlite3.connect(f"{path.resolve().as_uri()}?mode=ro", uri=True, timeout=2.0)) as connection:
                yield connection
        except sqlite3.Error as error:
            raise JournalFailed(f"the journal cannot be read: {error}", file=str(path)) from error


def _records(connection: sqlite3.Connection, query: str, run: int) -> list[Document]:
    rows = connection.execute(query, (run,)).fetchall()
    return [{"at": at, "kind": kind, "record": json.loads(record)} for at, kind, record in rows]


def _table(document: Document) -> Document:
    """Lists as lists; an empty bank has neither grid nor checksum."""
    for name in ("origin_mm", "step_mm", "shape"):
        document[name] = None if document[name] is None else json.loads(document[name])
    document["crc32"] = None if document["crc32"] is None else f"{document['crc32']:08x}"
    return document
