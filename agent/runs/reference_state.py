"""The last accepted night: what is known of the machine, and the table that acts since. The journal is the truth.

An estimate is accepted by a decision in the journal that names the table which acts with it; that a full calibration is
needed is such a decision too, and holds until a later night is accepted. A copy of the estimate lies beside the
journal, for people and for `volcal identify --carried-over`; nothing is read from it.
"""

from __future__ import annotations

import json
import sqlite3
from contextlib import closing
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any, Self

import numpy as np

from agent.execution.encoding import table_digest
from agent.execution.journal import FILE_NAME, RunJournal
from agent.files import write_atomically
from agent.planning.job import Job
from drivers.errors import ConfigurationError, InputError
from drivers.roles import TableImage
from twin.arrays import Array
from twin.formats.estimate_file import StoredEstimate, parse_estimate

COPY_NAME = "last-accepted.json"

_ACCEPTED, _FULL_NEEDED = "accepted", "full-calibration-needed"
_SECONDS_A_NIGHT = 86400.0
_ANY_RUN = 2**62

_LAST = (
    "SELECT runs.run_id, decisions.at, decisions.record, "
    "(SELECT record FROM estimates WHERE estimates.run = decisions.run ORDER BY estimates.rowid DESC LIMIT 1) "
    "FROM decisions JOIN runs USING (run) WHERE decisions.kind = ? AND decisions.run < ? "
    "ORDER BY decisions.rowid DESC LIMIT 1"
)
_PENDING = (
    "SELECT runs.run_id, decisions.at, decisions.record FROM decisions JOIN runs USING (run) "
    "WHERE decisions.kind = ? AND decisions.run < ? AND decisions.rowid > "
    "coalesce((SELECT max(rowid) FROM decisions WHERE kind = ? AND run < ?), 0) ORDER BY decisions.rowid DESC LIMIT 1"
)


@dataclass(frozen=True, eq=False)
class Accepted:
    """`written` (p,) mm or rad: parameters in the acting table, `crc32` of its image; `tool` it holds for."""

    machine: str
    artefact: str
    tool: str
    written: Array
    crc32: int

    @classmethod
    def of(cls, job: Job, written: Array, image: TableImage) -> Self:
        settings = job.settings
        return cls(settings.machine.name, settings.artefact.name, settings.tool, written, table_digest(image))


@dataclass(frozen=True, eq=False)
class LastAccepted:
    """`known`: the estimate of that night, everything that is carried over; `since`: UTC, when it was accepted."""

    run_id: str
    since: str
    accepted: Accepted
    known: StoredEstimate

    def nights_until(self, now: str) -> float:
        """Nights from then until `now` (UTC, ISO 8601); no fewer than none."""
        passed = datetime.fromisoformat(now) - datetime.fromisoformat(self.since)
        return max(passed.total_seconds() / _SECONDS_A_NIGHT, 0.0)


@dataclass(frozen=True)
class FullNeeded:
    """A durable decision: the next permitted slot is for a full calibration."""

    run_id: str
    since: str
    reason: str


def record_accepted(journal: RunJournal, accepted: Accepted) -> None:
    """Make the run's estimate the last accepted one; durable when it returns."""
    journal.decision(_ACCEPTED, {**vars(accepted), "written": accepted.written.tolist()})


def record_full_needed(journal: RunJournal, reason: str) -> None:
    """Have the next permitted slot calibrate in full; durable when it returns."""
    journal.decision(_FULL_NEEDED, {"reason": reason})


def write_copy(directory: Path, run_id: str) -> None:
    """Lay the estimate of `run_id` beside the journal where that is the last accepted night. InputError where the
    journal cannot be read or the directory not be written."""
    row = _one(directory, _LAST, (_ACCEPTED, _ANY_RUN))
    if row is not None and row[0] == run_id and row[3] is not None:
        write_atomically(directory / COPY_NAME, row[3])


def last_accepted(directory: Path, before_run: int = _ANY_RUN) -> LastAccepted | None:
    """From the journal in the state directory, as runs `before_run` have left it; None where no night was accepted yet.
    InputError where it cannot be read."""
    row = _one(directory, _LAST, (_ACCEPTED, before_run))
    if row is None:
        return None
    run_id, since, record, estimate = row
    source = f"estimate of run {run_id} in {directory / FILE_NAME}"
    if estimate is None:
        raise InputError("the accepted run has no estimate", file=str(directory / FILE_NAME), run=run_id)
    document = json.loads(record)
    document["written"] = np.array(document["written"], dtype=np.float64)
    return LastAccepted(run_id, since, Accepted(**document), parse_estimate(estimate, source))


def full_needed(directory: Path, before_run: int = _ANY_RUN) -> FullNeeded | None:
    """The decision that no accepted night has answered yet."""
    row = _one(directory, _PENDING, (_FULL_NEEDED, before_run, _ACCEPTED, before_run))
    return None if row is None else FullNeeded(row[0], row[1], json.loads(row[2])["reason"])


def accepted_for(job: Job, before_run: int = _ANY_RUN) -> LastAccepted | None:
    """The last accepted night of the job's machine; None where there is none or where it was of another one."""
    last = last_accepted(job.settings.state_directory, before_run)
    return None if last is None or strangeness(job, last) else last


def require_accepted(job: Job, before_run: int = _ANY_RUN) -> LastAccepted:
    """The same; ConfigurationError with the reason where there is none to be compared with."""
    directory = job.settings.state_directory
    last = last_accepted(directory, before_run)
    if last is None:
        raise ConfigurationError(
            "no night was accepted yet, so there is nothing to compare with",
            key="state_directory",
            file=str(directory),
            hint="run `volcal calibrate` first",
        )
    strange = strangeness(job, last)
    if strange:
        raise ConfigurationError(
            f"the last accepted night (run {last.run_id}) cannot be gone on with: {strange}",
            file=str(directory),
            hint="name the settings of that machine, or run `volcal calibrate` for this one",
        )
    return last


def strangeness(job: Job, last: LastAccepted) -> str:
    """Why an accepted night is none of this machine, artefact and tool; empty where it is."""
    settings, known, accepted = job.settings, last.known, last.accepted
    model, nominal = known.model, job.machine.model
    if accepted.machine != settings.machine.name:
        return f"it was of machine {accepted.machine}, not {settings.machine.name}"
    for name, old, new in (
        ("kinematic chain", str(model.chain), str(nominal.chain)),
        ("axis ranges", model.ranges_mm, nominal.ranges_mm),
        ("cross-effect", model.cross_effect, nominal.cross_effect),
    ):
        if old != new:
            return f"the machine has another {name} since"
    if accepted.tool != settings.tool or not (known.tool_offsets == job.tool_offset_mm).all():
        return f"it was measured with tool {accepted.tool} {known.tool_offsets[0].tolist()}, not {settings.tool}"
    if accepted.artefact != settings.artefact.name or not known.unknowns.artefact.belong_to(job.artefact):
        return f"it was measured with artefact {accepted.artefact} as certified then"
    return ""


def _one(directory: Path, query: str, values: tuple[str | int, ...]) -> tuple[Any, ...] | None:
    path = directory / FILE_NAME
    if not path.is_file():
        return None
    try:
        with closing(sqlite3.connect(f"{path.resolve().as_uri()}?mode=ro", uri=True, timeout=2.0)) as connection:
            row: tuple[Any, ...] | None = connection.execute(query, values).fetchone()
            return row
    except sqlite3.Error as error:
        raise InputError(f"the journal cannot be read: {error}", file=str(path)) from error
