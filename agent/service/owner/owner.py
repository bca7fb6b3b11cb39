"""Owner of the machine. It carries out one run at a time, regardless of the endpoint that requests the run."""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager
from dataclasses import replace
from functools import partial
from pathlib import Path
from queue import Queue

import structlog

from agent.errors import NotAllowedInState, PlanRefused, ResetMissing
from agent.execution.states import RunState
from agent.model_files import load_machine
from agent.planning.job import Job
from agent.planning.job_preparation import prepare_job
from agent.printable import MAX_REASON, one_line
from agent.results.run_requester import named
from agent.runs.kinds.restoration import TABLE_ROLES, Restoration, stored_table
from agent.runs.other_machine import require_own_state_directory
from agent.runs.planned_run import Kind
from agent.runs.reconcile_result import Reconciliation
from agent.runs.requested_run import job_of, kind_of
from agent.runs.resume.resume import resumable_origin
from agent.runs.run_context import RunHooks
from agent.runs.run_request import RunRequest, Source
from agent.runs.session import RunResult, new_run_id
from agent.service import allowed_requests
from agent.service.alarms import alarm_of
from agent.service.control import Alarm, Event, Status
from agent.service.owner.machine_use import MachineUse
from agent.service.owner.owner_parts import OwnerParts
from agent.service.owner.questions import Questions
from agent.service.owner.run_hooks import RunHooksFactory, night_slot
from agent.service.owner.run_mailbox import RunMailbox
from agent.service.owner.table_comparison import TableComparison
from agent.service.owner.unattended import minutes_until_end, require_permission, require_warm
from agent.service.state.status_board import IdleStatus
from agent.settings.load import naming
from agent.settings.schema import Settings
from drivers.errors import StoreError, UserError, VolcalError

log = structlog.get_logger()


class Owner:
    """Owner of the machine, which implements `Control`, the interface that all endpoints use."""

    def __init__(self, settings: Settings, parts: OwnerParts) -> None:
        self.settings = settings
        self._parts = parts
        self._board = parts.board
        self._questions = Questions(self._board.show_question)
        self._hooks = RunHooksFactory(parts, self._questions)
        self._comparison = TableComparison(parts)
        self.use = MachineUse()
        self._board.show_idle(replace(self._idle_status(), active_bank=None))  # not known before it is read
        left = parts.journal_state.unacknowledged_end()
        if left is not None:
            self._board.show_unacknowledged_end(
                left.state,
                left.run_id,
                left.kind,
                left.alarm,
                verdict=left.verdict,
                started=left.started,
                balls=left.balls,
                touches=left.touches,
            )
        self._board.show_left_open()

    # ------------------------------------------------------------------ Control

    def status(self) -> Status:
        return self._board.status()

    def subscribe(self) -> AbstractContextManager[Queue[Event]]:
        return self._parts.event_log.subscribe()

    def start(self, request: RunRequest, by: str = "") -> str:
        try:
            running, job = self._reserve_for(partial(job_of, request))
        except VolcalError as error:
            if request.source == "timer":  # nobody stands there to see the refusal
                self._note_not_started(request, error)
            raise
        try:
            slot = self._slot_minutes(request)
            kind = kind_of(request, slot_minutes=night_slot(request, self.settings.nightly, slot))
            hooks = self._hooks.hooks(running, job.settings.clock, attended=request.consent, slot_minutes=slot)
        except BaseException as error:
            self.use.release()
            if isinstance(error, VolcalError):
                self._note_not_started(request, error)
            raise
        return self._begin(running, job, kind, hooks, request.source, request.model_dump(mode="json"), by)

    def restore_table(self, run_id: str, role: str, source: Source, by: str = "") -> str:
        stored_table(self.settings.state_directory, run_id, role)
        running, job = self._reserve_for(prepare_job)
        try:
            self._comparison.make(self.settings)
            self._comparison.require_proved_table()
            kind = Restoration(run_id, next(known for known in TABLE_ROLES if known == role))
            hooks = self._hooks.hooks(running, job.settings.clock, attended=True)
        except BaseException:
            self.use.release()
            raise
        asked = {"source": source, "of_run": run_id, "role": role}
        return self._begin(running, job, kind, hooks, source, asked, by)

    def resume_run(self, source: Source, by: str = "") -> str:
        running = self._reserve()
        try:
            self._comparison.make(self.settings)
            origin = resumable_origin(self.settings.state_directory)
            running.run_id = origin.run_id
            hooks = self._hooks.hooks(running, self.settings.clock, attended=True)
        except BaseException:
            self.use.release()
            raise
        asked = {"source": source, "resumed": True, **named(by)}
        position_set = origin.settings.procedure.position_set
        self._board.begin_run(origin.run_id, origin.kind.name, source, position_set, by)
        self._launch(running, lambda: self._parts.resume(self.settings.state_directory, hooks, asked=asked))
        return origin.run_id

    def restore_former(self, by: str = "") -> None:
        self._settle(allowed_requests.RESTORE_FORMER, by, self._parts.machine.reconcile)

    def give_up(self, by: str = "") -> None:
        def give_up(settings: Settings, base: Path) -> Reconciliation:
            reason = f"asked by {by}" if by else "given up at an endpoint of the service"
            return self._parts.machine.give_up(settings, base, reason)

        self._settle(allowed_requests.GIVE_UP, by, give_up)

    def _settle(self, what: str, by: str, act: Callable[[Settings, Path], Reconciliation]) -> None:
        """Carry out a way out of an unproved table or of an unfinished run that needs no run. Raise StoreError if the
        table is still active, or if the run that is given up is still unfinished, and ConfigurationError if it is one
        of another machine."""
        with self.use.lock:
            self.use.await_work()  # first, since it releases the lock
            self.use.require_no_run()
            self._require(
                what,
                "it is allowed between runs, after a reset, while a table is active that was never proved; "
                "a run can also be given up while it is unfinished",
            )
            require_own_state_directory(self.settings)
            self._note(_SETTLING[what], by)
            given_up = self._board.status().unfinished
            found = act(self.settings, self._parts.config.parent)
            self._comparison.show(found)
            if found.unproved is not None:
                refused = f": {found.refused}" if found.refused else ""
                raise StoreError(f"{found.unproved.situation}{refused}", hint=found.instruction)
            left = found.unfinished  # an earlier run may be unfinished, too
            if what == allowed_requests.GIVE_UP and left is not None and given_up in (None, left.run_id):
                raise StoreError(f"the run is still unfinished: {found.state.value}", hint=found.instruction)

    def hold(self, by: str = "") -> None:
        if self._board.state is not RunState.HELD:  # until the axes have braked, a resumption can be taken back
            self._require(allowed_requests.HOLD, "a run can be held only while it is moving")
        self._on_running(RunMailbox.hold, "hold requested", by)
        self._record_request("hold requested", allowed_requests.HOLD, by)

    def resume(self, by: str = "") -> None:
        self._require(allowed_requests.RESUME, "only a run that is held can be resumed")
        self._on_running(RunMailbox.resume, "resume requested", by)
        self._record_request("resume requested", allowed_requests.RESUME, by)

    def abort(self, reason: str) -> None:
        said = one_line(reason, MAX_REASON)
        self._on_running(lambda running: running.abort(said), f"abort requested: {said}", "")

    def reset(self, by: str = "") -> None:
        with self.use.lock:
            self.use.await_work()
            self.use.require_no_run()
            if self._board.state in allowed_requests.STICKY or self._board.status().alarms:
                self._parts.journal_state.acknowledge(self._board.status().run_id, by)
            if self._board.state is not RunState.IDLE or self._board.status().alarms:
                if self._board.status().alarms:
                    self._comparison.repeat()  # the cause of an alarm may still stand
                self._board.reset()
            self.reconcile_if_reached()

    def answer(self, number: int, yes: bool, by: str = "") -> None:
        self._questions.answer(number, yes)
        text = f"question {number} answered with {'yes' if yes else 'no'}"
        self._note(text, by)
        self._record_request(text, allowed_requests.ANSWER, by)

    # ------------------------------------------------------------------ for the service itself

    @property
    def running_id(self) -> str | None:
        """Identity of the run in progress."""
        running = self.use.running
        return None if running is None else running.run_id

    @property
    def busy(self) -> bool:
        """True from the request for a run until its end."""
        return self.use.running is not None

    def reload(self, settings: Settings) -> None:
        """Use `settings` for the next runs.

        Raise Busy while a run is in progress, and UserError if `settings` names a different `state_directory`.
        """
        with self.use.lock:
            self.use.require_no_run()
            if settings.state_directory != self.settings.state_directory:
                raise UserError(
                    "`state_directory` can only be changed by restarting the service", key="state_directory"
                )
            self._board.set_machine(load_machine(settings.machine).name)
            self.settings = settings

    def close(self, within_s: float) -> bool:
        """Refuse new runs from now on, hold the run in progress, withdraw the probe and end the run.

        Wait at most `within_s` for the end of the run. Return True if the run ended in time or none was in progress.
        """
        with self.use.lock:
            self.use.close()
            running = self.use.running
            if running is not None:
                running.hold()
                running.interrupt("the service is being stopped")
        return self.use.wait(within_s)

    def wait(self, within_s: float) -> bool:
        """Wait at most `within_s` until no run is in progress. Return True if no run is in progress any longer."""
        return self.use.wait(within_s)

    def reconcile_if_reached(self) -> None:
        """Compare the compensation in the controller with the journal, if that is due and no run is in progress, and
        log any error instead of raising it. The active bank is then not known, so that the next reading compares. The
        idle machine is not read meanwhile.

        The error is not raised because the machine may still be off, and because the next run compares first anyway.
        """
        try:
            with self.use.lock:
                self.use.await_work()
                if self.use.running is None:
                    self._comparison.make_or_forget_bank(self.settings)
        except VolcalError as error:
            log.warning("compensation in the controller not checked yet", reason=str(error))

    def read_idle(self) -> None:
        """Ask the devices whether they answer and the controller which compensation is active, unless a run is in
        progress. A run that is requested meanwhile waits for the end of the reading."""
        with self.use.between_runs("the machine is being read") as idle:
            if not idle:
                return
            found = self._parts.machine.read(self.settings, self._parts.config.parent, self._board.must_compare)
            with self.use.lock:  # before the end of the work: a request that waits for it may change what was read
                if self.use.running is None:
                    self._board.show_reading(found)

    # ------------------------------------------------------------------ starting

    def _reserve_for(self, prepare: Callable[[Settings, Path], Job]) -> tuple[RunMailbox, Job]:
        """Reserve the machine for a new run, whose job `prepare` makes of the settings. It is made again if the
        settings are reloaded meanwhile: the run then uses the new ones."""
        while True:
            settings = self.settings
            with naming(self._parts.config):
                job = prepare(settings, self._parts.config.parent)
            with self.use.lock:
                if settings is self.settings:
                    return self._reserve(), job

    def _reserve(self) -> RunMailbox:
        with self.use.lock:
            self.use.require_service()
            self.use.require_no_run()
            self._require_reset()
            require_own_state_directory(self.settings)
            running = RunMailbox(new_run_id(), self._parts.health.beat)
            self.use.occupy(running)
            return running

    def _require_reset(self) -> None:
        status = self._board.status()
        if status.state not in allowed_requests.STICKY:
            return
        cause = status.alarms[0].text if status.alarms else status.doing
        further = "start again"
        if status.unfinished is not None:
            further = f"resume run {status.unfinished} (`volcal resume`), or start a new one"
        raise ResetMissing(
            f"run {status.run_id} ended {status.state.value} ({cause})",
            hint=f"remove the cause, reset (`volcal reset`), then {further}",
        )

    def _note_not_started(self, request: RunRequest, error: VolcalError) -> None:
        text = f"{request.kind} requested by {request.source} was not started: {error.message}"
        data = {"not_started": request.kind, "hint": error.hint, "source": request.source}
        self._parts.event_log.publish("note", text, data)
        log.warning(text, hint=error.hint)

    def _begin(
        self,
        run: RunMailbox,
        job: Job,
        kind: Kind,
        hooks: RunHooks,
        source: Source,
        asked: Mapping[str, object],
        by: str,
    ) -> str:
        base, recorded = self._parts.config.parent, {**asked, **named(by)}
        self._board.begin_run(run.run_id, kind.name, source, job.settings.procedure.position_set, by)
        self._launch(run, lambda: self._parts.carry_out(job, kind, base, hooks, run_id=run.run_id, asked=recorded))
        return run.run_id

    def _slot_minutes(self, request: RunRequest) -> float | None:
        """Return the available machine time in min, or None if it is not limited. Raise GateRefused or
        PermissionMissing if a run without consent may not start now, and PlanRefused if no run may.
        """
        self._comparison.make(self.settings)
        self._comparison.require_proved_table()
        slots = [request.slot_minutes, None if request.consent else self._unattended_minutes()]
        return min((slot for slot in slots if slot is not None), default=None)

    def _unattended_minutes(self) -> float | None:
        """Return the minutes until the permitted hours end, or None if the hours are not limited. Raise GateRefused or
        PermissionMissing if no run without consent may start now.
        """
        service, circumstances = self.settings.service, self._parts.circumstances()
        left = minutes_until_end(circumstances, service.hours)
        require_warm(circumstances, service.warm_up_minutes)
        require_permission(self._parts.machine.machine_status(self.settings, self._parts.config.parent))
        return left

    # ------------------------------------------------------------------ the run's thread

    def _launch(self, running: RunMailbox, carry_out: Callable[[], RunResult]) -> None:
        thread = threading.Thread(target=self._work, args=(running.run_id, carry_out), name=running.run_id, daemon=True)
        try:
            thread.start()
        except RuntimeError as error:  # the computer has no memory for it, or too many processes
            log.exception("no thread for the run")
            self._conclude(RunState.FAULTED, error)

    def _work(self, run_id: str, carry_out: Callable[[], RunResult]) -> None:
        self._parts.health.begin_run()
        with structlog.contextvars.bound_contextvars(run_id=run_id):
            try:
                ended = carry_out()
                self._board.show_outcome(ended.outcome)
            except VolcalError as error:
                self._conclude(_end_of(error), error)
            except BaseException as defect:  # the machine must be released and the defect reported
                log.exception("defect in the agent")
                self._conclude(RunState.FAULTED, defect)
            else:
                self._conclude(ended.outcome.state, ended.error)
                self._parts.reports.request(run_id)

    def _conclude(self, state: RunState, error: BaseException | None) -> None:
        idle, measured = self._idle_status(), self._measured()
        alarm = None if error is None else alarm_of(error)
        if alarm is not None:
            self._record(alarm)
        with self.use.lock:
            read = self._board.status()
            self._board.show_idle(idle)
            if measured is not None:
                self._board.show_measured(*measured)
            if state in allowed_requests.STICKY:
                self._board.show_bank(None)  # a link may be lost, or the bank be changed since it was read
            elif read.active_bank is not None:
                self._board.show_bank(read.active_bank)
            self._parts.live_view.end_run()
            if alarm is not None:
                self._board.alarm(alarm)
            if state in allowed_requests.STICKY:
                self._comparison.repeat()
            self._board.enter(state, str(error) if error is not None else state.value)
            self.use.release()

    # ------------------------------------------------------------------

    def _idle_status(self) -> IdleStatus:
        try:
            return self._parts.journal_state.idle_status(self.settings, self._parts.config.parent)
        except Exception:  # these figures are for display only: the machine must be released without them
            log.exception("state of the machine between runs unknown")
            return IdleStatus()

    def _record(self, alarm: Alarm) -> None:
        """Record the alarm with which the run ended. If this is not possible, only log it: the machine must be released
        and the alarm shown without it."""
        run_id = self._board.status().run_id
        try:
            if run_id is not None:
                self._parts.journal_state.record_alarm(run_id, alarm)
        except VolcalError as error:
            log.warning("the alarm will have lost its number after a restart", code=alarm.code, reason=str(error))

    def _measured(self) -> tuple[int, int] | None:
        try:
            return self._parts.journal_state.measured(self._board.status().run_id)
        except VolcalError as error:  # these numbers are for display only
            log.warning("measured balls of the run not known", error=str(error))
            return None

    def _require(self, what: str, why: str) -> None:
        status = self._board.status()
        if what not in status.may:
            raise NotAllowedInState(f"{what} is not allowed in state {status.state.value}", hint=why)

    def _on_running(self, action: Callable[[RunMailbox], None], text: str, by: str) -> None:
        with self.use.lock:
            running = self.use.running
            if running is not None:
                action(running)
                self._note(text, by)

    def _record_request(self, text: str, request: str, by: str) -> None:
        """Record in the journal what was asked of the run in progress. If this is not possible, only log it: the
        request has been carried out."""
        run_id = self.running_id
        try:
            if run_id is not None:
                self._parts.journal_state.record_request(run_id, {"text": text, "request": request, **named(by)})
        except VolcalError as error:
            log.warning("a request is not recorded in the journal", request=request, reason=str(error))

    def _note(self, text: str, by: str) -> None:
        """Tell and log what was requested, and by whom if the client has a name."""
        told = f"{text} by {by}" if by else text
        self._parts.event_log.publish("note", told)
        log.info(told)


_SETTLING = {
    allowed_requests.RESTORE_FORMER: "reactivation of the former table requested",
    allowed_requests.GIVE_UP: "end of the unfinished run requested",
}
"""What a request to settle an unfinished run asks for, in words."""


def _end_of(error: VolcalError) -> RunState:
    """Return the final state of a run that failed before it started, so that nothing has moved."""
    return RunState.REFUSED if isinstance(error, (PlanRefused, UserError)) else RunState.FAULTED
