"""Complete record of a run, read from the journal for the history database and for reports.

The functions of this module do not change the journal.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from agent.execution.journal_reader import JournalReader, has_journal, open_journal
from agent.execution.journal_rows import DecisionRow, EventRow, RunRow, StepRow, TableRow
from agent.execution.journal_schema import FILE_NAME
from agent.execution.stored_json import stored_json
from drivers.errors import InputError
from twin.units import S_PER_MIN

_NO_RUN = "check `state_directory`: no run has begun there"


@dataclass(frozen=True)
class OperatorQuestion:
    """Question that a run asked the operator.

    `minute` is the machine time of the question, in minutes after the start of the first step. `answered` is True if
    the answer was yes. `text` is the wording of the question. `error` is the text of the error with which the step that
    asked it ended; it is empty if there was no error.
    """

    minute: float
    text: str
    answered: bool
    error: str


class _StoredSettings:
    """Decoding and checksum of the JSON text `settings_text`, which contains the settings with which a run was
    started."""

    settings_text: str

    @property
    def settings(self) -> Mapping[str, Any]:
        document: dict[str, Any] = stored_json(self.settings_text)
        return document

    @property
    def settings_sha256(self) -> str:
        return hashlib.sha256(self.settings_text.encode()).hexdigest()


@dataclass(frozen=True)
class RunRecord(_StoredSettings):
    """Complete record of a run.

    `ordinal` is the number of the run in its journal, counted in the order in which the runs started. `settings_text`
    is the JSON text of the settings with which the run was started, exactly as stored. `estimate` is the JSON text of
    the run's last estimate of the machine's errors, or None if there is none. `balls` and `touches` are the numbers of
    measured balls and touches.

    Each entry of `temperatures` contains a machine time in minutes after the start of the first step, and a mapping
    from sensor names to temperatures in °C. `minutes` is the machine time in minutes from the start of the first step
    to the end of the last step.
    """

    ordinal: int
    run_id: str
    kind: str
    started: str
    ended: str | None
    state: str
    reason: str
    software: str
    settings_text: str
    decisions: tuple[DecisionRow, ...]
    events: tuple[EventRow, ...]
    questions: tuple[OperatorQuestion, ...]
    tables: tuple[TableRow, ...]
    temperatures: tuple[tuple[float, Mapping[str, float]], ...]
    estimate: str | None
    balls: int
    touches: int
    minutes: float

    def decision(self, kind: str) -> Mapping[str, Any] | None:
        """Return the content of the run's last decision of the kind `kind`; None if there is none."""
        return next((row.record for row in reversed(self.decisions) if row.kind == kind), None)

    def event(self, kind: str) -> Mapping[str, Any] | None:
        """Return the content of the run's last event of the kind `kind`; None if there is none."""
        return next((row.record for row in reversed(self.events) if row.kind == kind), None)

    def table(self, role: str) -> TableRow | None:
        """Return the row of the last compensation table that the run stored with the role `role` (backup, staged or
        restored); None if there is none.
        """
        return next((row for row in reversed(self.tables) if row.role == role), None)


@dataclass(frozen=True)
class RunHead(_StoredSettings):
    """Journal row of a run and the JSON text of its settings, without the steps and results of the run.
    `added_after_end` is True if decisions or tables were added to it after its end."""

    row: RunRow
    settings_text: str
    added_after_end: bool


@dataclass(frozen=True)
class RunSteps:
    """Steps of a run, and the settings, decoded from JSON, with which the run was started."""

    settings: Mapping[str, Any]
    steps: tuple[StepRow, ...]


def run_ids(directory: Path) -> tuple[str, ...]:
    """Return the identities of all runs of the journal in the state directory `directory`, in the order in which the
    runs started.

    Raises InputError if there is no journal or if it cannot be read.
    """
    _require_journal(directory, _NO_RUN)
    with open_journal(directory) as reader:
        return reader.run_ids()


def run_heads(directory: Path) -> tuple[RunHead, ...]:
    """Return the heads of all runs of the journal in the state directory `directory`, in the order in which the runs
    started. A head is the row of a run and its settings.

    Raises InputError if there is no journal or if it cannot be read.
    """
    _require_journal(directory, _NO_RUN)
    with open_journal(directory) as reader:
        late = reader.added_after_end()
        return tuple(RunHead(row, reader.settings_text(row.run), row.run in late) for row in reader.runs())


def read_record(directory: Path, run_id: str) -> RunRecord:
    """Return the complete record of the run `run_id` from the journal in the state directory `directory`.

    Raises InputError if there is no journal, if the journal cannot be read, or if it has no such run.
    """
    _require_journal(directory, _NO_RUN)
    with open_journal(directory) as reader:
        record = _record(reader, reader.require_run(run_id))
        for row in (*record.decisions, *record.events):
            _ = row.record  # decoded here, so that damage is found while the journal is read
        return record


def read_steps(directory: Path, run_id: str) -> RunSteps:
    """Return the steps of the run `run_id` and the settings with which it was started. They are read from the journal
    in the state directory `directory`.

    Raises InputError if there is no journal, if the journal cannot be read, or if it has no such run.
    """
    _require_journal(directory, "name the folder of a run in a state directory")
    with open_journal(directory) as reader:
        run = reader.require_run(run_id).run
        return RunSteps(stored_json(reader.settings_text(run)), reader.steps(run))


def _require_journal(directory: Path, hint: str) -> None:
    if not has_journal(directory):
        raise InputError("there is no journal", file=str(directory / FILE_NAME), hint=hint)


def _record(reader: JournalReader, row: RunRow) -> RunRecord:
    run = row.run
    span_s = reader.time_span_s(run)
    first_s, last_s = (0.0, 0.0) if span_s is None else span_s
    return RunRecord(
        ordinal=run,
        run_id=row.run_id,
        kind=row.kind,
        started=row.started,
        ended=row.ended,
        state=row.state,
        reason=row.reason or "",
        software=row.software,
        settings_text=reader.settings_text(run),
        decisions=reader.decisions(run),
        events=reader.events(run),
        questions=tuple(_question(first_s, step) for step in reader.steps(run, "AskOperator")),
        tables=reader.tables(run),
        temperatures=tuple((one.minutes, one.record) for one in reader.temperatures(run)),
        estimate=reader.last_estimate(run),
        balls=reader.count_balls(run),
        touches=reader.count_touches(run),
        minutes=(last_s - first_s) / S_PER_MIN,
    )


def _question(first_s: float, step: StepRow) -> OperatorQuestion:
    text = step.detail["request"]["text"]
    return OperatorQuestion((step.begun_s - first_s) / S_PER_MIN, text, step.finished_s is not None, step.error or "")
