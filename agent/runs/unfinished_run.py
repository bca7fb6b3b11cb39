"""Interrupted last run of the journal, and the reason if it cannot be resumed; nothing is changed."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from agent.execution.journal_reader import JournalReader, has_journal, open_journal
from agent.execution.states import FINAL, RunState

RESUMABLE_FAULTS = frozenset(
    {"LinkError", "LinkLost", "LinkTimeout", "ProtocolError", "PermissionMissing", "JournalFailed", "Interrupted"}
)
"""Errors from outside the measurement: results measured before them stay valid. After any other fault an assumption
about machine, artefact or procedure does not hold."""


@dataclass(frozen=True)
class UnfinishedRun:
    """The last run of the journal that did anything, if it was interrupted.

    `refusal`: why it cannot be resumed, empty if it can; `state`: the last one it entered; `started`: UTC;
    `balls`: number of stored centres; `last_step`: key of the last step that began.
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
    """Return the interrupted run that has not been followed by another; None if the last one ended regularly.

    For the owner of the machine only: a run in progress looks the same. Raise InputError if the journal cannot be read.
    """
    if not has_journal(state_directory):
        return None
    with open_journal(state_directory) as reader:
        return _last(reader)


def _last(reader: JournalReader) -> UnfinishedRun | None:
    row = reader.last_working_run()  # a run that was refused before it began does not hide an interrupted one
    if row is None:
        return None
    state = RunState(row.state)
    fault = _fault(reader, row.run) if state is RunState.FAULTED else ""
    if row.ended is not None and fault not in RESUMABLE_FAULTS:
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
        refusal=_refusal(reader, row.run, state),
    )


def _refusal(reader: JournalReader, run: int, state: RunState) -> str:
    if state is RunState.ABORTING or (state in FINAL and state is not RunState.FAULTED):
        return f"it was {state.value} on request"
    if not reader.has_origins():
        return "it was written by an older version, which stored too little of how it began"
    origin = reader.origin(run)
    if origin is None or origin.begun_s is None:
        return "it had not begun to measure; start it again"
    return ""


def _fault(reader: JournalReader, run: int) -> str:
    """Return the class of the error that ended the run: the first fault since it began or was last resumed."""
    first = ""
    for event in reader.events(run, ("fault", "state")):
        if event.kind == "state" and event.record["state"] == RunState.RESUMING.value:
            first = ""
        elif event.kind == "fault" and not first:
            first = str(event.record["type"])
    return first
