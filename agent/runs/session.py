"""Session of a run, from locking the machine to closing the journal.

A session locks the machine, opens the devices, runs the preflight, carries out the run and stores its results.

`carry_out` begins a new run; `agent.runs.resume.resume` continues an interrupted run. Both use `run_resources` (lock,
journal, clock, supervisor), `open_rig`, and a `RunSession`, which turns the progress of the run into a `RunResult`.
"""

from __future__ import annotations

import secrets
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

from agent.errors import Aborted, Interrupted, PlanRefused
from agent.execution.device_assembly import closing_clock, longest_wait_s
from agent.execution.engine import Engine
from agent.execution.journal import Journal
from agent.execution.run_state import RunStateTracker
from agent.execution.states import RunState
from agent.execution.supervisor import Supervisor
from agent.planning.job import Job
from agent.planning.time_model import time_model
from agent.probing.run_plan import VERIFIED
from agent.results.homing_scatter import AfterHoming
from agent.results.journal_entries import record_outcome
from agent.results.run_outcome import Outcome
from agent.runs.guard import attempt, carry_out_guarded
from agent.runs.last_homing import after_homing
from agent.runs.origin import origin_record
from agent.runs.other_machine import require_own_state_directory
from agent.runs.planned_run import Kind, PlannedRun, StartConditions
from agent.runs.reference_state import write_copy
from agent.runs.result_files import write_results
from agent.runs.run_context import RunContext, RunHooks, run_actions
from agent.runs.run_forecast import RunForecast
from agent.runs.run_start import enter_in_journal, last_preflight, read_start_conditions
from agent.runs.step_progress import StepProgress
from agent.settings.schema import ClockSettings
from drivers.clock import Clock, InterruptibleClock, utc_timestamp, wall_seconds
from drivers.errors import DeadlineExpired, LinkError, UserError, VolcalError
from twin.units import S_PER_MIN


@dataclass(frozen=True)
class RunResult:
    """Result of a run. `error` is the first error of a run that did not complete; it is None if the run completed."""

    outcome: Outcome
    error: VolcalError | None


def new_run_id() -> str:
    """Return a new run identity such as ``20261121T012233Z-3f2a``.

    Run identities sort by start time; identities of the same second differ in the random suffix.
    """
    stamp = utc_timestamp().split(".", maxsplit=1)[0].replace("-", "").replace(":", "")
    return f"{stamp}Z-{secrets.token_hex(2)}"


def carry_out(
    job: Job,
    kind: Kind,
    base: Path,
    hooks: RunHooks | None = None,
    *,
    run_id: str | None = None,
    asked: Mapping[str, object] | None = None,
) -> RunResult:
    """Carry out a new run.

    `base` is the directory to which relative paths in the settings refer. If `run_id` is None, a new identity is used.
    `asked` contains the source and content of the request; it is journaled with the run.

    Raises an error only if the run cannot be created because of the lock on the machine, the configuration or the
    journal. Once the run exists, its end, whether a success or an error, is returned as a `RunResult`.
    """
    hooks, run_id, settings = hooks or RunHooks(), run_id or new_run_id(), job.settings
    with run_resources(settings.state_directory, settings.clock, run_id, hooks) as resources:
        require_own_state_directory(settings)
        clock = resources.interruptible(resources.clock)
        rig = hooks.devices.assemble(settings, clock, base)
        journal = enter_in_journal(resources.journal, run_id, job, kind, clock, asked or {})
        tracker = RunStateTracker(journal, hooks.announce)
        steps = StepProgress(tracker, hooks.observe, rig)
        actions = run_actions(rig, journal, tracker, resources.supervisor, hooks)
        engine = Engine(actions, journal, steps.observe)
        context = RunContext(rig, engine, journal, tracker, resources.supervisor, clock, hooks)
        session = RunSession(context, steps, job, kind, resources.began_s)
        with session.ended_by_errors():
            tracker.enter(RunState.PREFLIGHT)
            with open_rig(context):
                start = read_start_conditions(rig, journal, settings.state_directory, tracker.note)
                journal.origin(origin_record(settings, kind, base, start))
                planned = session.plan(start)
                journal.begun()
                session.carry_out(planned)
        return session.result()


@dataclass(frozen=True)
class RunResources:
    """Resources that a run uses until its end. `began_s` is the wall-clock time in s at the beginning of the run."""

    journal: Journal
    clock: Clock
    supervisor: Supervisor
    began_s: float

    def interruptible(self, clock: Clock) -> Clock:
        """Return a clock that shows the time of `clock` and whose waits can be interrupted by the supervisor, which
        receives requests to hold or end the run.

        `clock` is the clock of these resources, or a clock based on it.
        """
        return InterruptibleClock(clock, self.supervisor.check, longest_wait_s(self.clock))


@contextmanager
def run_resources(
    state_directory: Path, clock_settings: ClockSettings, run_id: str, hooks: RunHooks
) -> Iterator[RunResources]:
    """Lock the machine, open the journal, and create the clock and the supervisor. Release all of them after the `with`
    block."""
    began_s = wall_seconds()
    with (
        hooks.lock(state_directory, run_id),
        _journal(state_directory) as journal,
        closing_clock(hooks.devices.make_clock(clock_settings)) as clock,
    ):
        supervisor = Supervisor(clock)
        hooks.attach(supervisor)
        yield RunResources(journal, clock, supervisor, began_s)


@contextmanager
def open_rig(context: RunContext) -> Iterator[None]:
    """Open the rig for the `with` block; during the block the run's supervisor can hold and resume the motion of the
    machine and of its mounts.

    Errors that occur when the rig is closed are recorded as notes on the run.
    """
    rig, tracker = context.rig, context.tracker

    def hold() -> None:
        rig.hold()
        tracker.hold()

    def brake() -> None:
        # A controller ignores a resumption while it still brakes for the hold. There is nothing to wait for if the link
        # is being restored, since no motion is followed then, and if a motion cannot be held, such as homing.
        check = context.supervisor.check_stop_request  # in the middle of a hold the clock does not call it
        with suppress(LinkError, DeadlineExpired):
            rig.await_standstill(check)
        check()  # after an abort the axes do not start again

    def resume() -> None:
        rig.resume()
        tracker.resume()

    rig.open()
    try:
        supervisor = context.supervisor
        supervisor.may_hold = tracker.may_hold
        supervisor.on_hold, supervisor.before_resume, supervisor.on_resume = hold, brake, resume
        yield
    finally:
        for complaint in rig.close():
            tracker.note(f"closing: {complaint}")


class RunSession:
    """Plan, progress and result of one run, new or resumed."""

    def __init__(self, context: RunContext, steps: StepProgress, job: Job, kind: Kind, began_s: float) -> None:
        """`began_s` is the wall-clock time in s at the beginning of the run."""
        self._context = context
        self._steps = steps
        self._job = job
        self._kind = kind
        self._began_s = began_s
        self._started_s = context.clock.now()
        self._planned: PlannedRun | None = None
        self.progress = steps.results

    def plan(self, start: StartConditions) -> PlannedRun:
        """Plan the run from the start conditions `start`, and call the caller's hook `preflight_passed` after the
        preflight. Raises PlanRefused or UserError if the run is refused."""
        context = self._context
        former = last_preflight(self._job.settings.state_directory, self._kind.name)
        watch = self._steps.simulating(context.supervisor.check_stop_request, former)
        planned = self._kind.plan(self._job, start, watch)
        context.hooks.preflight_passed(planned.job, planned.preflight)
        self._planned = planned
        context.tracker.note(
            "preflight passed: no collision, no limit",
            machine_minutes=planned.preflight.machine_minutes,
            commands=planned.preflight.commands,
            wall_seconds=planned.preflight.wall_seconds,
            latencies=planned.job.latencies_text,
            **self._steps.preflight.as_record(),
        )
        self._steps.begin(_forecast(planned))
        return planned

    def carry_out(self, planned: PlannedRun) -> None:
        """Carry out the plan of the run until it reaches a final state."""
        carry_out_guarded(planned.procedure(), planned.job, self._context, self.progress)

    @contextmanager
    def ended_by_errors(self) -> Iterator[None]:
        """End the run if the `with` block raises a `VolcalError`.

        At the time of such an error this process has moved nothing yet, because a run that has begun to measure handles
        its errors itself.
        """
        try:
            yield
        except VolcalError as error:
            self.progress.error = error
            self._enter_end(error)

    def _enter_end(self, error: VolcalError) -> None:
        enter, reason = self._context.tracker.enter, str(error)
        if isinstance(error, (Aborted, Interrupted)):
            enter(RunState.ABORTING, reason)
            enter(RunState.ABORTED, reason)
            return
        refused = isinstance(error, (PlanRefused, UserError))
        if not refused:
            self._context.journal.fault(error)
        enter(RunState.REFUSED if refused else RunState.FAULTED, reason)

    def result(self) -> RunResult:
        """Journal the outcome of the run, write the result files if the caller's hooks require it, and return the
        result of the run.

        If the result files cannot be written, for example because the disk is full, this is the error of the result
        only if the run has no error of its own.
        """
        context, error = self._context, self.progress.error
        outcome = self._outcome()
        attempt("record the outcome", lambda: record_outcome(context.journal, outcome))
        if context.hooks.write_files:
            self._feed_history()
            try:
                outcome = self._write_files(outcome)
            except VolcalError as failure:
                self._note(f"no result files: {failure}")
                error = error or failure
        return RunResult(outcome, error)

    def _write_files(self, outcome: Outcome) -> Outcome:
        outcome = write_results(self._measured_job, outcome, self.progress, self._report())
        write_copy(self._measured_job.settings.state_directory, self._context.journal.run_id)
        return outcome

    @property
    def _measured_job(self) -> Job:
        planned = self._job if self._planned is None else self._planned.job
        return self.progress.job or planned

    def _feed_history(self) -> None:
        """Update the history of runs.

        If the database of the history cannot be reached, only a note is journaled, because the run and its journal are
        complete without the history.
        """
        from agent.history.feed import update_history  # noqa: PLC0415  a database's client, needed once a run

        complaint = update_history(self._measured_job.settings, self._context.journal.run_id)
        if complaint:
            self._note(complaint)

    def _report(self) -> Mapping[str, str | bytes]:
        """Return the files of the report; empty if the run was not planned or the report could not be rendered.

        `volcal report` can render it later.
        """
        if self._planned is None:
            return {}
        try:
            return self._context.hooks.reports(
                self._measured_job.settings.state_directory, self._context.journal.run_id
            )
        except VolcalError as error:
            self._note(f"no report: {error}")
            return {}

    def _after_homing(self) -> AfterHoming | None:
        """Return the effect of the next homing; None if it is not known, or if the run says nothing about the
        accuracy of the machine."""
        progress = self.progress
        if progress.estimation is None and progress.night is None:
            return None
        estimate = None if progress.estimation is None else progress.estimation.estimate
        try:
            return after_homing(self._measured_job, estimate, self._context.journal.run)
        except VolcalError as error:
            self._note(f"the effect of a homing is not known: {error}")
            return None

    def _note(self, complaint: str) -> None:
        attempt("note the complaint", lambda: self._context.tracker.note(complaint))

    def _outcome(self) -> Outcome:
        context, progress, estimation = self._context, self.progress, self.progress.estimation
        settings = self._measured_job.settings
        minutes = (context.clock.now() - self._started_s) / S_PER_MIN
        return Outcome(
            state=context.tracker.state,
            run_id=context.journal.run_id,
            position_set=settings.procedure.position_set,
            formulation=settings.identification.formulation,
            balls=self._steps.balls if estimation is None else estimation.observations.size,
            touches=self._steps.touches,
            machine_minutes=minutes,
            wall_seconds=wall_seconds() - self._began_s,
            link_interruptions=sum(context.rig.link_interruptions().values()),
            predicted_minutes=None if self._planned is None else self._planned.preflight.machine_minutes,
            run_time=self._steps.run_time(minutes),
            table_bank=progress.active_bank,
            report=None,
            estimation=estimation,
            proof=progress.proof,
            confirmed=progress.confirmed,
            night=progress.night,
            trial=progress.trial,
            after_homing=self._after_homing(),
            reversal=() if progress.prepared is None else progress.prepared.reversals,
            kind=self._kind.name,
            reason=progress.end_reason or ("" if progress.error is None else str(progress.error)),
        )


def _forecast(planned: PlannedRun) -> RunForecast:
    job, preflight = planned.job, planned.preflight
    verified = any(VERIFIED in branch.concluded for branch in preflight.branches)
    model = time_model(job.machine, job.settings.timing)
    return RunForecast(preflight, model, job.held_out if verified else ())


@contextmanager
def _journal(directory: Path) -> Iterator[Journal]:
    journal = Journal(directory)
    try:
        yield journal
    finally:
        journal.close()
