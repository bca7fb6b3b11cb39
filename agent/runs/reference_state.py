"""Reference state of a machine: the estimate of the last accepted night, and the table active since.

The journal is the single source: an estimate is accepted by a decision that names the table activated with it. The need
for a full calibration is such a decision too, and holds until a later night is accepted. A copy of the estimate is
written beside the journal, for people and for `volcal identify --carried-over`; nothing is read from it.
"""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Self

import numpy as np

from agent.execution.encoding import table_digest
from agent.execution.journal import RunJournal
from agent.execution.journal_reader import ANY_RUN, has_journal, open_journal
from agent.execution.journal_rows import DecisionRow
from agent.execution.journal_schema import FILE_NAME
from agent.files import write_atomically
from agent.planning.job import Job
from drivers.errors import ConfigurationError, InputError
from drivers.roles import TableImage
from twin.arrays import Array
from twin.formats.estimate_file import StoredEstimate, parse_estimate
from twin.units import S_PER_DAY

COPY_NAME = "last-accepted.json"

TABLE_RESTORED = "table-restored"
_ACCEPTED, _FULL_NEEDED = "accepted", "full-calibration-needed"
ACTIVATING_DECISIONS = frozenset({_ACCEPTED, TABLE_RESTORED})
"""Kinds of the decisions that make the staged table of their run the one expected to be active."""


@dataclass(frozen=True, eq=False)
class AcceptedTable:
    """`written` (p,) mm or rad: parameters in the active table; `crc32` of its image; `tool` for which it holds."""

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
class ReferenceState:
    """`estimate`: that of that night, all that is carried over; `since`: UTC time of acceptance."""

    run_id: str
    since: str
    table: AcceptedTable
    estimate: StoredEstimate

    def nights_until(self, now: str) -> float:
        """Return nights from the acceptance until `now` (UTC, ISO 8601); 0 or more."""
        passed = datetime.fromisoformat(now) - datetime.fromisoformat(self.since)
        return max(passed.total_seconds() / S_PER_DAY, 0.0)


@dataclass(frozen=True)
class FullCalibrationNeed:
    """Durable decision that the next permitted slot is for a full calibration."""

    run_id: str
    since: str
    reason: str


def record_accepted(journal: RunJournal, accepted: AcceptedTable) -> None:
    """Make the run's estimate the last accepted one; durable when it returns."""
    journal.decision(_ACCEPTED, {**vars(accepted), "written": accepted.written.tolist()})


def record_full_calibration_need(journal: RunJournal, reason: str) -> None:
    """Request a full calibration in the next permitted slot; durable when it returns."""
    journal.decision(_FULL_NEEDED, {"reason": reason})


def write_copy(directory: Path, run_id: str) -> None:
    """Write the estimate of `run_id` beside the journal if that is the last accepted night. Raise InputError if the
    journal cannot be read or the directory cannot be written."""
    decision, estimate = _accepted(directory, ANY_RUN)
    if decision is not None and decision.run_id == run_id and estimate is not None:
        write_atomically(directory / COPY_NAME, estimate)


def read_reference(directory: Path, before_run: int = ANY_RUN) -> ReferenceState | None:
    """Return the last accepted night from the journal in the state directory, of runs numbered below `before_run`; None
    if no night has been accepted yet. Raise InputError if the journal cannot be read."""
    decision, estimate = _accepted(directory, before_run)
    if decision is None:
        return None
    source = f"estimate of run {decision.run_id} in {directory / FILE_NAME}"
    if estimate is None:
        raise InputError("the accepted run has no estimate", file=str(directory / FILE_NAME), run=decision.run_id)
    accepted = AcceptedTable(**{**decision.record, "written": np.array(decision.record["written"], dtype=np.float64)})
    return ReferenceState(decision.run_id, decision.at, accepted, parse_estimate(estimate, source))


def full_calibration_need(directory: Path, before_run: int = ANY_RUN) -> FullCalibrationNeed | None:
    """Return the last decision that a full calibration is needed, unless a later night was accepted."""
    if not has_journal(directory):
        return None
    with open_journal(directory) as reader:
        needed = reader.last_decision(_FULL_NEEDED, before_run)
        accepted = reader.last_decision(_ACCEPTED, before_run)
    if needed is None or (accepted is not None and accepted.number > needed.number):
        return None
    return FullCalibrationNeed(needed.run_id, needed.at, needed.record["reason"])


def reference_for(job: Job, before_run: int = ANY_RUN) -> ReferenceState | None:
    """Return the last accepted night of the job's machine; None if there is none or it was of another machine."""
    reference = read_reference(job.settings.state_directory, before_run)
    return None if reference is None or mismatch(job, reference) else reference


def require_reference(job: Job, before_run: int = ANY_RUN) -> ReferenceState:
    """Return the same; raise ConfigurationError, with the reason, if there is none to compare with."""
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
    """Return why an accepted night does not belong to this machine, artefact and tool; empty if it does."""
    settings, known, accepted = job.settings, reference.estimate, reference.table
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
    if accepted.artefact != settings.artefact.name or not known.unknowns.artefact.matches(job.artefact):
        return f"it was measured with artefact {accepted.artefact} as certified then"
    return ""


def _accepted(directory: Path, before_run: int) -> tuple[DecisionRow | None, str | None]:
    """Return the last accepting decision and the text of its run's last estimate."""
    if not has_journal(directory):
        return None, None
    with open_journal(directory) as reader:
        decision = reader.last_decision(_ACCEPTED, before_run)
        return decision, None if decision is None else reader.last_estimate(decision.run)
