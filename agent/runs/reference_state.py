"""Reference state of a machine: the estimate of the last accepted night, and the table that has been active since then.

The journal, the database of all runs, is the only source of the reference state. One kind of decision in it accepts an
estimate and names the table that is active from then on. Another kind states that a full calibration is needed; such a
decision is valid until a later night is accepted. A copy of the accepted estimate is written beside the journal. It is
made for people and for `volcal identify --carried-over`, and runs do not read it.
"""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Self

import numpy as np

from agent.execution.encoding import is_same_table, table_digest
from agent.execution.journal import RunJournal
from agent.execution.journal_reader import ANY_RUN, has_journal, open_journal
from agent.execution.journal_rows import DecisionRow
from agent.execution.journal_schema import FILE_NAME
from agent.execution.stored_json import damage_reported
from agent.files import translated, write_atomically
from agent.planning.job import Job
from drivers.errors import ConfigurationError, InputError
from drivers.roles import TableImage
from twin.arrays import Array
from twin.errors import FormatError
from twin.formats.estimate_file import StoredEstimate, parse_estimate
from twin.units import S_PER_DAY

COPY_NAME = "last-accepted.json"

TABLE_RESTORED = "table-restored"
_ACCEPTED, _FULL_NEEDED = "accepted", "full-calibration-needed"
ACTIVATING_DECISIONS = frozenset({_ACCEPTED, TABLE_RESTORED})
"""Kinds of decision after which the table staged by the same run is expected to be active."""


def active_digest(image: TableImage | None) -> int:
    """Return the CRC-32 checksum of the active table, or 0 if no compensation is active."""
    return 0 if image is None else table_digest(image)


@dataclass(frozen=True, eq=False)
class AcceptedTable:
    """Compensation table that has been active since its acceptance. A machine may also have been accepted without
    compensation.

    `written` (p,) contains the values in mm or rad of the p parameters of the error model that the table corrects.
    `tool` is the tool for which the table is valid. `crc32` is the CRC-32 of the table's integers, as the controller
    stores them; it is 0 without compensation.
    """

    machine: str
    artefact: str
    tool: str
    written: Array
    crc32: int

    @classmethod
    def of(cls, job: Job, written: Array, image: TableImage | None) -> Self:
        settings = job.settings
        return cls(settings.machine.name, settings.artefact.name, settings.tool, written, active_digest(image))


@dataclass(frozen=True, eq=False)
class ReferenceState:
    """Estimate and compensation table of the last accepted night. A full calibration counts as a night here.

    `run_id` is the run of that night. `since` is the UTC time of its acceptance in ISO 8601. `table` is the table that
    has been active since then, and `image` this table as the controller stores it; it is None without compensation, or
    if the journal does not contain it. `estimate` is the estimate of that night, which becomes the prior of the next
    night.
    """

    run_id: str
    since: str
    table: AcceptedTable
    estimate: StoredEstimate
    image: TableImage | None = None

    def is_table(self, active: TableImage | None) -> bool:
        """Return True if `active`, the active table or None without compensation, is the accepted one."""
        if active_digest(active) != self.table.crc32:
            return False
        return self.image is None or is_same_table(active, self.image)

    def nights_until(self, now: str) -> float:
        """Return the number of nights (periods of 24 h) from the acceptance of this estimate until `now` (UTC, ISO
        8601). The number may have a fraction; it is at least 0."""
        passed = datetime.fromisoformat(now) - datetime.fromisoformat(self.since)
        return max(passed.total_seconds() / S_PER_DAY, 0.0)


@dataclass(frozen=True)
class FullCalibrationNeed:
    """Decision that a full calibration is needed. It was made by the run `run_id`; the next slot that permits a full
    calibration is used for it."""

    run_id: str
    since: str
    reason: str


def record_accepted(journal: RunJournal, accepted: AcceptedTable) -> None:
    """Record in the journal that the estimate of the run and the compensation table `accepted` have been accepted."""
    journal.decision(_ACCEPTED, {**vars(accepted), "written": accepted.written.tolist()})


def record_full_calibration_need(journal: RunJournal, reason: str) -> None:
    """Record in the journal that a full calibration is needed in the next slot that permits it."""
    journal.decision(_FULL_NEEDED, {"reason": reason})


def write_copy(directory: Path, run_id: str) -> None:
    """Write a copy of the estimate of `run_id` beside the journal, but only if that run is the last whose estimate was
    accepted.

    Raises InputError if the journal cannot be read or the copy cannot be written.
    """
    decision, estimate = _accepted(directory, ANY_RUN)
    if decision is not None and decision.run_id == run_id and estimate is not None:
        write_atomically(directory / COPY_NAME, estimate)


def read_reference(directory: Path, before_run: int = ANY_RUN) -> ReferenceState | None:
    """Return the estimate and the table of the last accepted night among the runs with numbers below `before_run`; None
    if there is no such night.

    Raises InputError if the journal or the estimate in it cannot be read.
    """
    with translated(InputError):
        return _reference(directory, before_run)


def full_calibration_need(directory: Path, before_run: int = ANY_RUN) -> FullCalibrationNeed | None:
    """Return the last decision that requires a full calibration, among the runs with numbers below `before_run`.

    The result is None if there is no such decision, or if the estimate of a later run was accepted.
    """
    if not has_journal(directory):
        return None
    with open_journal(directory) as reader:
        needed = reader.last_decision(_FULL_NEEDED, before_run)
        accepted = reader.last_decision(_ACCEPTED, before_run)
    if needed is None or (accepted is not None and accepted.number > needed.number):
        return None
    return FullCalibrationNeed(needed.run_id, needed.at, needed.record["reason"])


def reference_for(job: Job, before_run: int = ANY_RUN) -> ReferenceState | None:
    """Return the estimate and the table of the last accepted night. The result is None if there is no accepted night,
    if that night does not belong to the job's machine, artefact and tool, or if its estimate was stored by an earlier
    version in a format that cannot be used any more."""
    try:
        reference = _reference(job.settings.state_directory, before_run)
    except FormatError:
        return None
    return None if reference is None or mismatch(job, reference) else reference


def require_reference(job: Job, before_run: int = ANY_RUN) -> ReferenceState:
    """Return the estimate and the table of the last accepted night. Raises ConfigurationError, with the reason, if
    there is no accepted night, or if that night does not belong to the job's machine, artefact and tool."""
    directory = job.settings.state_directory
    reference = read_reference(directory, before_run)
    if reference is None:
        raise ConfigurationError(
            "no night has been accepted yet, so there is nothing to compare with",
            key="state_directory",
            file=str(directory),
            hint="run `volcal calibrate` first",
        )
    difference = mismatch(job, reference)
    if difference:
        raise ConfigurationError(
            f"the last accepted night (run {reference.run_id}) cannot be continued: {difference}",
            file=str(directory),
            hint="pass the settings of that machine, or run `volcal calibrate` for this one",
        )
    return reference


def mismatch(job: Job, reference: ReferenceState) -> str:
    """Return the reason why the accepted night `reference` does not belong to the job's machine, artefact and tool. The
    text is empty if it does."""
    settings, known, accepted = job.settings, reference.estimate, reference.table
    model, nominal = known.model, job.machine.model
    if accepted.machine != settings.machine.name:
        return f"it was of machine {accepted.machine}, not {settings.machine.name}"
    for name, old, new in (
        ("kinematic chain", str(model.chain), str(nominal.chain)),
        ("axis ranges", model.ranges_mm, nominal.ranges_mm),
        ("cross-effect", (model.cross_effect, model.structure), (nominal.cross_effect, nominal.structure)),
    ):
        if old != new:
            return f"the {name} of the machine has been changed since"
    if accepted.tool != settings.tool or not (known.tool_offsets == job.tool_offset_mm).all():
        return f"it was measured with tool {accepted.tool} {known.tool_offsets[0].tolist()}, not {settings.tool}"
    if accepted.artefact != settings.artefact.name or not known.unknowns.artefact.matches(job.artefact):
        return f"it was measured with artefact {accepted.artefact} as certified then"
    return ""


def _reference(directory: Path, before_run: int) -> ReferenceState | None:
    decision, estimate = _accepted(directory, before_run)
    if decision is None:
        return None
    source = f"estimate of run {decision.run_id} in {directory / FILE_NAME}"
    if estimate is None:
        raise InputError("the accepted run has no estimate", file=str(directory / FILE_NAME), run=decision.run_id)
    known = parse_estimate(estimate, source)
    with damage_reported(InputError, directory / FILE_NAME):
        written = np.array(decision.record["written"], dtype=np.float64)
        accepted = AcceptedTable(**{**decision.record, "written": written})
    with open_journal(directory) as reader:
        image = reader.image_with_digest(decision.run, accepted.crc32)
    return ReferenceState(decision.run_id, decision.at, accepted, known, image)


def _accepted(directory: Path, before_run: int) -> tuple[DecisionRow | None, str | None]:
    """Return the last decision that accepts an estimate, and the JSON text of the last estimate of its run."""
    if not has_journal(directory):
        return None, None
    with open_journal(directory) as reader:
        decision = reader.last_decision(_ACCEPTED, before_run)
        return decision, None if decision is None else reader.last_estimate(decision.run)
