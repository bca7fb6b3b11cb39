"""What the journal tells the service between two runs: how the machine stands, and how the last run ended."""

from __future__ import annotations

import sqlite3
from collections.abc import Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import structlog

from agent.errors import JournalFailed
from agent.execution.journal import FILE_NAME, Journal
from agent.execution.states import FINAL, RunState
from agent.planning.job import prepare_job
from agent.runs.kinds.drift_check import Judge
from agent.runs.reference_state import accepted_for
from agent.runs.unfinished_run import unfinished_run
from agent.service.allowed_requests import STICKY
from agent.service.control import Alarm
from agent.service.state.status_board import Standing
from agent.settings.schema import Settings
from drivers.clock import utc_timestamp
from drivers.errors import VolcalError

log = structlog.get_logger()

BROKEN_OFF_CODE = 480
FAULT_CODE = 100

# A reset leaves the event "acknowledged" with the run, so that a fault stays one over a restart of the service; a run
# that is gone on with enters states after it, and what it then ends in is a fault of its own.
_LAST = (
    "SELECT run_id, kind, state, reason, "
    "coalesce((SELECT max(rowid) FROM events WHERE events.run = runs.run AND events.kind = 'acknowledged'), 0) > "
    "coalesce((SELECT max(rowid) FROM events WHERE events.run = runs.run AND events.kind = 'state'), 0) "
    "FROM runs ORDER BY run DESC LIMIT 1"
)
_ACTIVE = (
    "SELECT bank FROM tables WHERE role IN ('backup', 'restored') OR (role = 'staged' AND EXISTS "
    "(SELECT 1 FROM decisions WHERE decisions.run = tables.run AND decisions.kind IN ('accepted', 'table-restored'))) "
    "ORDER BY rowid DESC LIMIT 1"
)


@dataclass(frozen=True)
class LeftBehind:
    """A run whose end nobody has acknowledged yet."""

    state: RunState
    run_id: str
    kind: str
    alarm: Alarm


@dataclass(frozen=True)
class Past:
    """Reads through connections of its own, which do not hinder the run that writes."""

    directory: Path

    def left_behind(self) -> LeftBehind | None:
        """The last run where it was aborted, faulted or broken off, and no reset has answered that."""
        row = self._one(_LAST)
        if row is None or row[4]:
            return None
        run_id, kind, state, reason = row[0], row[1], RunState(row[2]), row[3]
        if state in STICKY:
            return LeftBehind(state, run_id, kind, Alarm(FAULT_CODE, reason or state.value, "see to it, then reset"))
        if state in FINAL or state is RunState.WRITTEN:
            return None
        text = f"run {run_id} was broken off while {state.value}"
        hint = "look at the machine: nothing is known of what happened since; then reset"
        return LeftBehind(RunState.FAULTED, run_id, kind, Alarm(BROKEN_OFF_CODE, text, hint))

    def acknowledge(self, run_id: str | None) -> None:
        """Durable when it returns, and aside from the procedure, so that the run can be gone on with. JournalFailed
        where it cannot be written."""
        path = self.directory / FILE_NAME
        if run_id is None or not path.is_file():
            return
        Journal(self.directory).close()  # one of an older version is brought up to date
        try:
            with closing(sqlite3.connect(path, timeout=2.0)) as connection, connection:
                connection.execute("PRAGMA synchronous=FULL")
                connection.execute(
                    "INSERT INTO events (run, at, kind, record, aside) "
                    "SELECT run, ?, 'acknowledged', '{}', 1 FROM runs WHERE run_id = ?",
                    (utc_timestamp(), run_id),
                )
        except sqlite3.Error as error:
            raise JournalFailed(
                f"the reset cannot be recorded: {error}", hint="check the disk under `state_directory`", file=str(path)
            ) from error

    def standing(self, settings: Settings, base: Path) -> Standing:
        """Empty where nothing is known; what cannot be read is said in the log and is no reason not to serve."""
        try:
            row, unfinished = self._one(_ACTIVE), unfinished_run(self.directory)
            before_um, now_um = _volumetric_errors(settings, base)
        except VolcalError as error:
            log.warning("what the machine was left as is not known", error=str(error))
            return Standing()
        return Standing(
            ve_before_um=before_um,
            ve_now_um=now_um,
            active_bank=None if row is None else row[0],
            unfinished=unfinished.run_id if unfinished is not None and unfinished.resumable else None,
        )

    def _one(self, query: str) -> tuple[Any, ...] | None:
        path = self.directory / FILE_NAME
        if not path.is_file():
            return None
        with _reading(path) as connection:
            row: tuple[Any, ...] | None = connection.execute(query).fetchone()
            return row


@contextmanager
def _reading(path: Path) -> Iterator[sqlite3.Connection]:
    try:
        with closing(sqlite3.connect(f"{path.resolve().as_uri()}?mode=ro", uri=True, timeout=2.0)) as connection:
            yield connection
    except sqlite3.Error as error:
        raise JournalFailed(f"the journal cannot be read: {error}", file=str(path)) from error


def _volumetric_errors(settings: Settings, base: Path) -> tuple[float | None, float | None]:
    """VE in µm, aligned, that the last accepted night expects: with no table, and with the one that acts since."""
    job = prepare_job(settings, base)
    last = accepted_for(job)
    if last is None:
        return None, None
    judge, known = Judge(job, last, 0.0), last.known
    bare = judge.acting.of(known.z, known.z_covariance, np.zeros_like(last.accepted.written))
    return bare.aligned_um, judge.before_um
