"""One run from settings to a closed journal: lock, devices, preflight, what its kind does, report."""

from __future__ import annotations

import secrets
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path

from agent.errors import Aborted, Interrupted, PlanRefused
from agent.execution.device_assembly import assemble, closed_after, make_clock, slice_of
from agent.execution.engine import Observer
from agent.execution.journal import Journal, RunJournal
from agent.execution.rig import Rig
from agent.execution.run_lock import run_lock
from agent.execution.run_state import Listener, RunStateTracker
from agent.execution.states import RunState
from agent.execution.steps import Record, Step
from agent.execution.supervisor import Supervisor
from agent.planning.job import Job
from agent.planning.preflight import PreflightResult
from agent.reports.renderer import Reports, rebuilt_here
from agent.results.journal_entries import record_outcome
from agent.results.run_outcome import Outcome
from agent.runs.guarded_run import Means, Progress, attempt
from agent.runs.kinds.kind import FullCalibration, Kind, Ready
from agent.runs.reference_state import write_copy
from agent.runs.result_files import write_results
from agent.runs.run_start import Beginning, Fresh, Wanted
from agent.runs.start_conditions import Outset
from agent.settings.schema import Settings
from drivers.clock import Clock, InterruptibleClock, utc_timestamp, wall_seconds
from drivers.errors import UserError, VolcalError


def new_run_id() -> str:
    """``20261121T012233Z-3f2a``: sorts by time, and two runs in one second differ."""
    stamp = utc_timestamp().split(".", maxsplit=1)[0].replace("-", "").replace(":", "")
    return f"{stamp}Z-{secrets.token_hex(2)}"


@dataclass(frozen=True)
class Request:
    """What somebody asked for. `interrupts` is handed the supervisor, so that signals can reach it.

    `clock` and `rig`: instead of those that the settings describe, for a machine that somebody holds already. `files`:
    whether results are written as files too; the journal has them anyway. `asked`: who wanted it and how, kept with
    the run. `lock`: what keeps everybody else from the machine meanwhile. `observer` sees every step and its result.
    `passed` is handed what has passed its preflight, and may still refuse it.
    `beginning`: anew, or where a run that broke off goes on. `reports` makes the files of its report.
    """

    job: Job
    base: Path
    listener: Listener
    interrupts: Callable[[Supervisor], None]
    kind: Kind = field(default_factory=FullCalibration)
    clock: Clock | None = None
    rig: Callable[[Settings, Clock, Path], Rig] | None = None
    files: bool = True
    run_id: str = field(default_factory=new_run_id)
    asked: Mapping[str, object] = field(default_factory=dict)
    lock: Callable[[Path, str], AbstractContextManager[None]] = run_lock
    observer: Observer | None = None
    passed: Callable[[Ready], None] = lambda _: None
    beginning: Beginning = field(default_factory=Fresh)
    reports: Reports = rebuilt_here


@dataclass(frozen=True)
class RunResult:
    """`error` is the first cause where the run did not complete."""

    outcome: Outcome
    error: VolcalError | None


def carry_out(request: Request) -> RunResult:
    """Carry out a run of any kind. Raises before a run exists (lock, link, configuration); afterwards every end,
    good or bad, is an `RunResult` with the journal closed."""
    began = wall_seconds()
    settings = request.job.settings
    run_id = request.run_id
    with (
        request.lock(settings.state_directory, run_id),
        _journal(settings.state_directory) as journal,
        closed_after(request.clock or make_clock(settings.clock)) as outer,
    ):
        supervisor = Supervisor(outer)
        request.interrupts(supervisor)
        clock = InterruptibleClock(request.beginning.clock(outer), supervisor.check, slice_of(outer))
        rig = (request.rig or assemble)(settings, clock, request.base)
        wanted = Wanted(run_id, request.job, request.kind, request.base)
        run_journal, tracker = request.beginning.written(journal, wanted, clock, request.listener)
        if request.asked:
            run_journal.event("asked", request.asked)
        session = _Session(request, run_id, clock, supervisor, run_journal, tracker)
        return session.run(rig, began)


class _Session:
    def __init__(
        self,
        request: Request,
        run_id: str,
        clock: Clock,
        supervisor: Supervisor,
        journal: RunJournal,
        tracker: RunStateTracker,
    ) -> None:
        self._request = request
        self._beginning = request.beginning
        self._run_id = run_id
        self._clock = clock
        self._supervisor = supervisor
        self._journal = journal
        self._tracker = tracker
        self._job = request.job
        self._touches = 0
        self._balls = 0
        self._preflight_result: PreflightResult | None = None

    def run(self, rig: Rig, began: float) -> RunResult:
        started_s = self._clock.now()
        progress = Progress()
        try:
            self._tracker.enter(self._beginning.state)
            progress = self._on(rig)
        except VolcalError as error:
            progress.error = error
            self._not_begun(error)
        minutes = (self._clock.now() - started_s) / 60.0
        outcome = self._outcome(progress, minutes, wall_seconds() - began)
        attempt("record the outcome", lambda: record_outcome(self._journal, outcome))
        if self._request.files:
            self._feed_history()
            outcome = write_results(self._job, outcome, progress, self._report())
            write_copy(self._job.settings.state_directory, self._run_id)
        return RunResult(outcome, progress.error)

    def _not_begun(self, error: VolcalError) -> None:
        """Nothing has moved."""
        if isinstance(error, (Aborted, Interrupted)):
            self._tracker.enter(RunState.ABORTING, str(error))
            self._tracker.enter(RunState.ABORTED, str(error))
            return
        refused = isinstance(error, (PlanRefused, UserError))
        self._tracker.enter(RunState.REFUSED if refused else RunState.FAULTED, str(error))

    def _feed_history(self) -> None:
        """The machine is as it should be and the journal has it all: a database that is away is worth a note."""
        from agent.history.sync import feed  # noqa: PLC0415  a database's client, wanted once a run

        complaint = feed(self._job.settings, self._run_id)
        if complaint:
            attempt("note the complaint", lambda: self._tracker.note(complaint))

    def _report(self) -> Mapping[str, str | bytes]:
        """Empty where nothing was begun, or where it could not be made; `volcal report` makes it any time."""
        if self._preflight_result is None:
            return {}
        try:
            return self._request.reports(self._job.settings.state_directory, self._run_id)
        except VolcalError as error:
            complaint = f"no report: {error}"
            attempt("note the complaint", lambda: self._tracker.note(complaint))
            return {}

    def _on(self, rig: Rig) -> Progress:
        rig.open()
        try:
            self._supervisor.on_hold = lambda: self._hold(rig)
            self._supervisor.on_resume = lambda: self._resume(rig)
            request = self._request
            wanted = Wanted(self._run_id, request.job, request.kind, request.base)
            ready = self._preflight(self._beginning.outset(rig, self._journal, wanted))
            engine = self._beginning.engine(rig, self._journal, self._observe)
            run = ready.begin(Means(rig, engine, self._journal, self._tracker, self._supervisor, self._clock))
            self._beginning.begun(run, self._journal, self._tracker)
            progress = run.carry_out()
            if progress.error is not None:
                self._beginning.broken_off(rig, self._tracker.note)
            self._job = progress.job or self._job
            return progress
        finally:
            for complaint in rig.close():
                self._tracker.note(f"closing: {complaint}")

    def _hold(self, rig: Rig) -> None:
        rig.machine.hold()
        self._tracker.hold()

    def _resume(self, rig: Rig) -> None:
        rig.machine.resume()
        self._tracker.go_on()

    def _preflight(self, outset: Outset) -> Ready:
        ready = self._request.kind.ready(self._job, replace(outset, watch=self._supervisor.look))
        self._request.passed(ready)
        self._job, self._preflight_result = ready.job, ready.preflight
        preflight = ready.preflight
        self._tracker.note(
            "preflight passed: no collision, no limit",
            machine_minutes=preflight.machine_minutes,
            commands=preflight.commands,
            wall_seconds=preflight.wall_seconds,
        )
        return ready

    def _observe(self, step: Step, result: object) -> None:
        """Report progress on the time scale of the preflight: the share done and the minutes left at this step."""
        if self._request.observer is not None:
            self._request.observer(step, result)
        if type(step).__name__ == "TouchTowards":
            self._touches += 1
        if isinstance(step, Record) and "note" in step.payload:
            self._tracker.told(step.payload["note"])
        if not isinstance(step, Record) or step.kind != "ball" or self._preflight_result is None:
            return
        self._balls += 1
        done_s = self._preflight_result.timeline.get(step.key)
        if done_s is not None:
            left_s = self._preflight_result.machine_seconds - done_s
            self._tracker.progress(
                step.key, fraction=done_s / self._preflight_result.machine_seconds, minutes_left=left_s / 60.0
            )

    def _outcome(self, progress: Progress, minutes: float, wall_s: float) -> Outcome:
        finding = progress.finding
        return Outcome(
            state=self._tracker.state,
            run_id=self._run_id,
            position_set=self._job.settings.procedure.position_set,
            formulation=self._job.settings.identification.formulation,
            balls=self._balls if finding is None else finding.observations.size,
            touches=self._touches,
            machine_minutes=minutes,
            wall_seconds=wall_s,
            predicted_minutes=None if self._preflight_result is None else self._preflight_result.machine_minutes,
            table_bank=progress.active_bank,
            report=None,
            rank=None if finding is None else finding.estimate.rank,
            parameters=None if finding is None else finding.estimate.model.size,
            estimated_ve_um=None if finding is None else finding.volumetric.before_aligned.value_um,
            predicted_vce_um=None if finding is None else finding.volumetric.after_aligned.value_um,
            chi2_normalised=None if finding is None else finding.estimate.chi2_normalised,
            rejected=() if finding is None else finding.estimate.rejected,
            proof=progress.proof,
            night=progress.night,
            reversal=() if progress.prepared is None else progress.prepared.reversals,
            kind=self._request.kind.name,
            reason="" if progress.error is None else str(progress.error),
        )


@contextmanager
def _journal(directory: Path) -> Iterator[Journal]:
    journal = Journal(directory)
    try:
        yield journal
    finally:
        journal.close()
