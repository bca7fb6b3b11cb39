"""State of the service between two runs, read from the journal. It comprises the state of the machine and, until a
reset has acknowledged it, the way in which the last run ended."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

import structlog

from agent.errors import Aborted, Interrupted, JournalFailed
from agent.execution.journal import Journal
from agent.execution.journal_reader import JournalReader, has_journal, open_journal
from agent.execution.journal_rows import RunRow
from agent.execution.states import FINAL, RunState
from agent.planning.job_preparation import prepare_job
from agent.results.run_requester import named
from agent.results.run_verdict import UNFINISHED, RunVerdict, run_figures
from agent.runs.reconcile import unproved_table
from agent.runs.reference_state import ACTIVATING_DECISIONS, reference_for
from agent.runs.unfinished_run import unfinished_run
from agent.service.alarms import CODES, AlarmCode, code_of_name, recorded_alarm
from agent.service.allowed_requests import STICKY
from agent.service.control import Alarm
from agent.service.state.idle_alarms import alarm_record
from agent.service.state.status_board import IdleStatus
from agent.settings.schema import Settings
from drivers.errors import VolcalError

log = structlog.get_logger()


_ENDED_BADLY = STICKY | {RunState.REFUSED}
"""Final states of which the alarm stays until a reset."""


@dataclass(frozen=True)
class UnacknowledgedEnd:
    """End of a run that no reset has acknowledged yet. `started` is the UTC time of its start; `balls` and `touches`
    are the numbers of its measured balls and of its touches."""

    state: RunState
    run_id: str
    kind: str
    alarm: Alarm
    verdict: RunVerdict
    started: str
    balls: int
    touches: int


@dataclass(frozen=True)
class JournalState:
    """Reader of the journal for the state between two runs. It has its own connections, which never delay a run that is
    writing."""

    directory: Path

    def unacknowledged_end(self) -> UnacknowledgedEnd | None:
        """Return the end of the last run if it was aborted, faulted, interrupted or refused with an alarm, and no reset
        has acknowledged it. Otherwise return None.

        The alarm is the one that the service has recorded. If there is none, because the run was not the service's or
        the service ended with it, the alarm has the number of the error that the run has journaled.
        """
        if not has_journal(self.directory):
            return None
        with open_journal(self.directory, JournalFailed) as reader:
            run = reader.last_run()
            if run is None or _acknowledged(reader, run.run):
                return None
            measured = (run.started, reader.count_balls(run.run), reader.count_touches(run.run))
            recorded, verdict = _recorded_alarm(reader, run.run), _verdict(reader, run)
            journaled = _journaled_code(reader, run)
            state = RunState(run.state)
        left = unfinished_run(self.directory)
        resumes = f"; `volcal resume` then resumes run {left.run_id}" if left is not None and left.resumable else ""
        if state in _ENDED_BADLY and (recorded is not None or state in STICKY):
            hint = f"remove the cause, then reset{resumes}"
            alarm = recorded or Alarm(journaled.code, run.reason or state.value, hint)
            return UnacknowledgedEnd(state, run.run_id, run.kind, alarm, verdict, *measured)
        if state in FINAL or state is RunState.WRITTEN:
            return None
        if recorded is not None:  # a defect ended the run before it could journal its end
            return UnacknowledgedEnd(RunState.FAULTED, run.run_id, run.kind, recorded, UNFINISHED, *measured)
        text = f"run {run.run_id} was interrupted while {state.value}"
        hint = f"check the machine, since nothing was recorded after that; then reset{resumes}"
        alarm = Alarm(CODES[Interrupted].code, text, hint)
        return UnacknowledgedEnd(RunState.FAULTED, run.run_id, run.kind, alarm, UNFINISHED, *measured)

    def measured(self, run_id: str | None) -> tuple[int, int] | None:
        """Return the numbers of measured balls and of touches of a run; None if the journal does not have it."""
        if run_id is None or not has_journal(self.directory):
            return None
        with open_journal(self.directory, JournalFailed) as reader:
            run = reader.run(run_id)
            return None if run is None else (reader.count_balls(run.run), reader.count_touches(run.run))

    def last_run_id(self) -> str | None:
        """Return the identity of the last run, or None if there is none."""
        if not has_journal(self.directory):
            return None
        with open_journal(self.directory, JournalFailed) as reader:
            run = reader.last_run()
        return None if run is None else run.run_id

    def end_number(self, run_id: str) -> int:
        """Return the number of the last change of state of a run, which differs for each end of a resumed run."""
        with open_journal(self.directory, JournalFailed) as reader:
            return reader.last_event_number(reader.require_run(run_id).run, "state")

    def acknowledge(self, run_id: str | None, by: str = "") -> None:
        """Record in the journal that the end of a run is acknowledged, and by whom unless `by` is empty. Raise
        JournalFailed if the record cannot be written."""
        if run_id is None or not has_journal(self.directory):
            return
        with closing(Journal(self.directory)) as journal:
            journal.acknowledge(run_id, named(by))

    def record_alarm(self, run_id: str, alarm: Alarm) -> None:
        """Record in the journal the alarm with which a run ended, so that it keeps its number and cause when the
        service is restarted. Raise JournalFailed if the record cannot be written."""
        if not has_journal(self.directory):
            return
        with closing(Journal(self.directory)) as journal:
            journal.record_alarm(run_id, alarm_record(alarm))

    def record_request(self, run_id: str, record: Mapping[str, str]) -> None:
        """Record in the journal what a person asked of a run in progress. Raise JournalFailed if the record cannot be
        written."""
        if has_journal(self.directory):
            with closing(Journal(self.directory)) as journal:
                journal.record_request(run_id, record)

    def idle_status(self, settings: Settings, base: Path) -> IdleStatus:
        """Return the state of the machine as recorded in the journal. If the journal cannot be read, log the error and
        return an empty state."""
        try:
            active_bank, unfinished = self._active_bank(), unfinished_run(self.directory)
            unproved = unproved_table(self.directory)
            before_um, now_um = _volumetric_errors(settings, base)
        except VolcalError as error:
            log.warning("state of the machine between runs unknown", error=str(error))
            return IdleStatus()
        return IdleStatus(
            ve_before_um=before_um,
            ve_now_um=now_um,
            active_bank=active_bank if unproved is None else unproved.bank,
            unproved=unproved,
            unfinished=unfinished.run_id if unfinished is not None and unfinished.resumable else None,
        )

    def _active_bank(self) -> int | None:
        if not has_journal(self.directory):
            return None
        with open_journal(self.directory, JournalFailed) as reader:
            table = reader.last_active_table(ACTIVATING_DECISIONS)
        return None if table is None else table.bank


def _acknowledged(reader: JournalReader, run: int) -> bool:
    """Return True if a reset has acknowledged the end of the run.

    A reset stores the event "acknowledged" with the run, so that an unacknowledged fault survives a restart of the
    service. A run that is resumed enters new states after this event, so a later fault must be acknowledged again."""
    return reader.last_event_number(run, "acknowledged") > reader.last_event_number(run, "state")


def _recorded_alarm(reader: JournalReader, run: int) -> Alarm | None:
    """Return the alarm that the service has recorded since the run last changed its state."""
    since = reader.last_event_number(run, "state")
    rows = reader.events(run, ("alarm",), after=since)
    if not rows:
        return None
    alarm = recorded_alarm(rows[-1].record)
    if alarm is None:
        log.warning("the recorded alarm cannot be read", number=rows[-1].number)
    return alarm


def _journaled_code(reader: JournalReader, run: RunRow) -> AlarmCode:
    """Return the alarm code of the last error that the run has journaled."""
    faults = reader.events(run.run, ("fault",))
    unnamed = Aborted if run.state == RunState.ABORTED.value else VolcalError
    return code_of_name(str(faults[-1].record.get("type", "")) if faults else "", CODES[unnamed])


def _verdict(reader: JournalReader, run: RunRow) -> RunVerdict:
    figures = run_figures(run.state, reader.decision_records(run.run))
    return figures.verdict(run.kind, run.state, ended=True)


def _volumetric_errors(settings: Settings, base: Path) -> tuple[float | None, float | None]:
    """Return the volumetric errors in µm of the machine without a table (VE) and with the active one (VCE), as the runs
    themselves state them: VE of the last accepted run, VCE of the latest run since then that states one.

    Both are None if there is no accepted run. VCE is also None if another table than the accepted one is active.
    """
    last = reference_for(prepare_job(settings, base))
    if last is None:
        return None, None
    with open_journal(settings.state_directory, JournalFailed) as reader:
        accepted = reader.require_run(last.run_id)
        active = reader.last_active_table(ACTIVATING_DECISIONS)
        ve_um = run_figures(accepted.state, reader.decision_records(accepted.run)).ve_um
        if active is None or (active.crc32 or 0) != last.table.crc32:
            return ve_um, None
        since = (row for row in reader.latest_begun_runs() if row.run >= accepted.run)
        stated = (run_figures(row.state, reader.decision_records(row.run)).vce_um for row in since)
        return ve_um, next((vce_um for vce_um in stated if vce_um is not None), None)
