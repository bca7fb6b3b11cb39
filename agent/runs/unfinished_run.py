"""Search for an interrupted run at the end of the journal. If such a run cannot be resumed, the search also gives the
reason."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from agent.execution.journal_reader import JournalReader, has_journal, open_journal
from agent.execution.journal_rows import RunRow
from agent.execution.states import FINAL, RunState
from agent.runs.reference_state import ACTIVATING_DECISIONS
from agent.runs.unproved_table import GIVEN_UP

INTERRUPTED = "Interrupted"
"""Error of a run whose program had to end."""
RESUMABLE_FAULTS = frozenset(
    {
        "LinkError",
        "LinkLost",
        "LinkTimeout",
        "ProtocolError",
        "PermissionMissing",
        "MotionFault",
        "DeadlineExpired",
        "ArtefactMoved",
        "ThermometerFault",
        "JournalFailed",
        INTERRUPTED,
    }
)
"""Errors that do not come from the measurement, so that results measured before them remain valid. Any other fault
means that an assumption about machine, artefact or procedure is wrong.

A motion fault may have moved the artefact. The return to the position therefore touches known balls again, and a
position whose balls are not where they were is measured again. `GuardTripped`, a motion fault in which the probe has
touched something, is not among these errors.

A thermometer fault is one of a reading that is not used. A resumed run goes on only with a reading that agrees with
those before it.
"""

RESTORE = "restore"
"""Kind of the run that reactivates a stored table. It measures nothing that a new one would have to repeat."""
STOPPED = "Aborted"
"""Error of a run that a person has stopped."""


@dataclass(frozen=True)
class UnfinishedRun:
    """Interrupted run after which no other run has measured or written tables.

    `started` is the UTC time of the start. `state` is the last state that the run entered. `balls` is the number of
    stored ball centres. `last_step` is the key of the last step that began. `refusal` is the reason why the run cannot
    be resumed; it is empty if the run can be resumed.
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
    """Return the last run if it was interrupted, or if it was stopped and has left an unproved table active, which it
    can still prove. Return None if it ended regularly or if the journal contains no run.

    Only the process that owns the machine may call this function, because a run in progress looks like an interrupted
    one. Raise InputError if the journal cannot be read.
    """
    if not has_journal(state_directory):
        return None
    with open_journal(state_directory) as reader:
        return _last(reader)


def _last(reader: JournalReader) -> UnfinishedRun | None:
    """Return the last run that has measured or written tables if it is unfinished.

    Later runs that ended before they had done either do not hide it. If it is finished, or if there is none, return the
    latest of those later runs if that one is unfinished.
    """
    later: UnfinishedRun | None = None
    for row in reader.latest_begun_runs():
        if not reader.has_worked(row.run):
            later = later or _unfinished(reader, row)
            continue
        found = _unfinished(reader, row)
        if found is None and later is not None and (row.ended or "") >= later.started:
            return None  # this run was resumed after the later one had ended
        return found or later
    return later


def _unfinished(reader: JournalReader, row: RunRow) -> UnfinishedRun | None:
    """Return what is known of the run if it is unfinished."""
    state = RunState(row.state)
    fault = _fault(reader, row.run) if state in (RunState.FAULTED, RunState.ABORTING) else ""
    stopped = state is RunState.ABORTED or fault == STOPPED
    unproved = stopped and left_unproved(reader, row.run) and not _was_given_up(reader, row.run)
    if row.ended is not None and fault not in RESUMABLE_FAULTS and not unproved:
        return None
    return UnfinishedRun(
        run=row.run,
        run_id=row.run_id,
        kind=row.kind,
        started=row.started,
        state=state,
        reason=row.reason or "",
        balls=reader.count_balls(row.run),
        last_step=reader.last_step_key(row.run) or "",
        refusal=_refusal(reader, row, state, fault, unproved=unproved),
    )


def _refusal(reader: JournalReader, row: RunRow, state: RunState, fault: str, *, unproved: bool) -> str:
    if row.kind == RESTORE:
        return "it restores a stored table, and does not go on; ask for the restoration again"
    if unproved:
        return ""
    if state is RunState.ABORTING and fault not in ("", STOPPED):
        if fault not in RESUMABLE_FAULTS:
            return "it was ending after a fault with which no run goes on"
    elif state is RunState.ABORTING or (state in FINAL and state is not RunState.FAULTED):
        return f"it was {state.value} on request"
    origin = reader.origin(row.run)
    if origin is None or origin.begun_s is None:
        return "it had not begun to measure; start it again"
    return ""


def _fault(reader: JournalReader, run: int) -> str:
    """Return the class name of the first fault since the run began or was last resumed; empty if there is none.

    An error before the return of a resumed run counts as an interruption, whatever its class: nothing has moved since
    the run was found resumable.
    """
    first = ""
    for event in reader.events(run, ("fault", "state")):
        if event.kind == "state" and event.record["state"] == RunState.RESUMING.value:
            first = ""
        elif event.kind == "fault" and not first:
            first = INTERRUPTED if event.record.get("before_return") else str(event.record["type"])
    return first


def left_unproved(reader: JournalReader, run: int) -> bool:
    """Return True if the run activated a table that it neither accepted nor took back, according to the journal
    alone. A resumed run activates its table again after it was taken back, so both are counted."""
    staged = reader.last_table(run, "staged")
    if staged is None or reader.has_decision(run, ACTIVATING_DECISIONS):
        return False
    activations = [step for step in reader.steps(run, "ActivateBank") if step.error is None]
    activated = sum(step.detail["bank"] == staged.bank for step in activations)
    restored = sum(table.role == "restored" for table in reader.tables(run))
    return bool(activated > restored)


def _was_given_up(reader: JournalReader, run: int) -> bool:
    return reader.last_event_number(run, GIVEN_UP) > 0
