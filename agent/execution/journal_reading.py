"""A run as the journal has it, for who looks back at it; nothing is created and nothing is changed."""

from __future__ import annotations

import json
import sqlite3
from collections.abc import Mapping
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from agent.execution.journal import FILE_NAME
from drivers.errors import InputError


@dataclass(frozen=True)
class JournaledStep:
    """`detail` and `result` as `agent.execution.encoding` wrote them; None where a step did not end."""

    key: str
    kind: str
    detail: Mapping[str, Any]
    begun_s: float
    finished_s: float | None
    result: Any


@dataclass(frozen=True)
class JournaledRun:
    """`settings`: the document that the run was started with."""

    settings: Mapping[str, Any]
    steps: tuple[JournaledStep, ...]


def read_run(directory: Path, run_id: str) -> JournaledRun:
    """A run from the journal in the state directory. InputError where there is no such journal or run."""
    path = directory / FILE_NAME
    if not path.is_file():
        raise InputError("there is no journal", file=str(path), hint="name the folder of a run in a state directory")
    try:
        with closing(sqlite3.connect(f"{path.resolve().as_uri()}?mode=ro", uri=True, timeout=2.0)) as connection:
            return _read(connection, path, run_id)
    except sqlite3.Error as error:
        raise InputError(f"the journal cannot be read: {error}", file=str(path)) from error


def _read(connection: sqlite3.Connection, path: Path, run_id: str) -> JournaledRun:
    row = connection.execute("SELECT run, settings FROM runs WHERE run_id = ?", (run_id,)).fetchone()
    if row is None:
        known = [name for (name,) in connection.execute("SELECT run_id FROM runs ORDER BY run DESC LIMIT 3")]
        hint = f"the last ones are: {', '.join(known)}" if known else "it has no run yet"
        raise InputError(f"the journal has no run {run_id}", file=str(path), hint=hint)
    run, settings = row
    steps = connection.execute(
        "SELECT key, kind, detail, begun, finished, result FROM steps WHERE run = ? ORDER BY ordinal", (run,)
    )
    return JournaledRun(json.loads(settings), tuple(_step(*values) for values in steps))


def _step(key: str, kind: str, detail: str, begun: float, finished: float | None, result: str | None) -> JournaledStep:
    return JournaledStep(key, kind, json.loads(detail), begun, finished, None if result is None else json.loads(result))
