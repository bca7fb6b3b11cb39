"""The owner of the machine: one run at a time, whichever door it was asked for through."""

from __future__ import annotations

import threading
from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import asdict
from queue import Queue

import structlog

from agent.errors import Busy, PlanRefused
from agent.execution.states import RunState
from agent.files import load_machine
from agent.planning.job import prepare_job
from agent.runs.kinds.restoration import ROLES, Restoration, stored_table
from agent.runs.resume.resume import origin_of, require_resumable
from agent.runs.session import Request, RunResult, new_run_id
from agent.service import allowed_requests
from agent.service.alarms import alarm_of
from agent.service.control import Event, Source, StartRequest, Status
from agent.service.owner.owner_parts import Household
from agent.service.owner.questions import Questions
from agent.service.owner.request_translation import job_of, kind_of
from agent.service.owner.run_mailbox import Running
from agent.service.owner.run_requests import Orders
from agent.service.state.status_board import Standing
from agent.settings.load import naming
from agent.settings.schema import Settings
from drivers.errors import PermissionMissing, UserError, VolcalError

log = structlog.get_logger()


class Owner:
    """Implements `Control`."""

    def __init__(self, settings: Settings, household: Household) -> None:
        self.settings = settings
        self._house = household
        self._board = household.board
        self._questions = Questions(self._board.ask)
        self._orders = Orders(household, self._questions)
        self._changed = threading.Condition(threading.RLock())
        self._running: Running | None = None
        self._closing = False
        self._reconciled = False
        self._board.stands(self._standing())
        left = household.journal_state.unacknowledged_end()
        if left is not None:
            self._board.show_unacknowledged_end(left.state, left.run_id, left.kind, left.alarm)

    # ------------------------------------------------------------------ Control

    def status(self) -> Status:
        return self._board.status()

    def subscribe(self) -> AbstractContextManager[Queue[Event]]:
        return self._house.bulletin.subscribe()

    def start(self, request: StartRequest) -> str:
        job = job_of(request, self.settings, self._house.config)
        running = self._reserve()
        try:
            slot = self._slot_minutes(request)
            kind = kind_of(request, self.settings, slot)
            asked = {**asdict(request), "source": request.source.value}
            ordered = self._orders.anew(running, job, kind, asked, attended=request.consent, slot_minutes=slot)
        except BaseException as error:
            self._not_started(request, error)
            raise
        return self._begin(running, ordered, request.source)

    def restore_table(self, run_id: str, role: str, source: Source) -> str:
        with naming(self._house.config):
            job = prepare_job(self.settings, self._house.config.parent)
        stored_table(self.settings.state_directory, run_id, role)
        running = self._reserve()
        try:
            kind = Restoration(run_id, next(known for known in ROLES if known == role))
            asked = {"source": source.value, "of_run": run_id, "role": role}
            ordered = self._orders.anew(running, job, kind, asked, attended=True)
        except BaseException:
            self._release()
            raise
        return self._begin(running, ordered, source)

    def resume_run(self, source: Source) -> str:
        running = self._reserve()
        try:
            self.reconcile()
            run = require_resumable(self.settings.state_directory)
            origin = origin_of(self.settings.state_directory, run)
            origin.require_unchanged()
        except BaseException:
            self._release()
            raise
        running.run_id = run.run_id
        ordered = self._orders.going_on(running, source, self.settings)
        self._board.begins(run.run_id, run.kind, source, origin.settings.procedure.position_set)
        self._launch(running, lambda: self._house.go_on(ordered))
        return run.run_id

    def hold(self) -> None:
        self._require(allowed_requests.HOLD, "only what moves can be held")
        self._on_running(Running.hold, "hold asked for")

    def resume(self) -> None:
        self._require(allowed_requests.RESUME, "only what is held can go on")
        self._on_running(Running.resume, "resume asked for")

    def abort(self, reason: str) -> None:
        self._on_running(lambda running: running.abort(reason), f"abort asked for: {reason}")

    def reset(self) -> None:
        with self._changed:
            self._require_nothing_runs()
            if self._board.state in allowed_requests.STICKY:
                self._house.journal_state.acknowledge(self._board.status().run_id)
            if self._board.state is not RunState.IDLE:
                self._board.idle()
            self.reconcile_if_reached()

    def answer(self, number: int, yes: bool) -> None:
        self._questions.answer(number, yes)

    # ------------------------------------------------------------------ for the service itself

    def reload(self, settings: Settings) -> None:
        """Settings for the runs to come. Busy while one is under way."""
        with self._changed:
            self._require_nothing_runs()
            if settings.state_directory != self.settings.state_directory:
                raise UserError("`state_directory` changes only with a restart of the service", key="state_directory")
            self._board.belongs_to(load_machine(settings.machine).name)
            self.settings = settings

    def close(self, within_s: float) -> bool:
        """Take no more; hold, withdraw and end what goes on. Whether it ended in time."""
        with self._changed:
            self._closing = True
            if self._running is not None:
                self._running.hold()
                self._running.interrupt("the service is being stopped")
            return self._changed.wait_for(lambda: self._running is None, within_s)

    def wait(self, within_s: float) -> bool:
        """Until no run is under way; whether that came true in time."""
        with self._changed:
            return self._changed.wait_for(lambda: self._running is None, within_s)

    def reconcile(self) -> None:
        """At the start, and once more after a run that was broken off: ask the controller what the last run has left in
        it, and take an unproved table back. Raises DeviceError where the machine cannot be asked; then it will be asked
        before the next run."""
        if not self._reconciled:
            found = self._house.devices.reconciled(self.settings, self._house.config.parent)
            self._reconciled = True
            self._board.reconciled(found)

    def reconcile_if_reached(self) -> None:
        """The same; a machine that is still off is asked before the next run."""
        try:
            self.reconcile()
        except VolcalError as error:
            log.warning("what the last run has left cannot be asked now", reason=str(error))

    # ------------------------------------------------------------------ starting

    def _reserve(self) -> Running:
        with self._changed:
            if self._closing:
                raise Busy("the service is being stopped", hint="start it again")
            self._require_nothing_runs()
            self._require_reset()
            self._running = Running(new_run_id(), self._house.health.beat)
            return self._running

    def _release(self) -> None:
        with self._changed:
            self._running = None
            self._changed.notify_all()

    def _require_nothing_runs(self) -> None:
        if self._running is not None:
            raise Busy(f"run {self._running.run_id} is under way", hint="wait for it or abort it")

    def _require_reset(self) -> None:
        status = self._board.status()
        if status.state not in allowed_requests.STICKY:
            return
        cause = status.alarms[0].text if status.alarms else status.doing
        raise PermissionMissing(
            f"run {status.run_id} ended {status.state.value} ({cause})",
            hint="see to the cause, then reset (`volcal reset`), then start again",
        )

    def _not_started(self, request: StartRequest, error: BaseException) -> None:
        self._release()
        if isinstance(error, VolcalError):
            text = f"{request.kind} asked for by {request.source.value} was not started: {error.message}"
            self._house.bulletin.publish("note", text, {"hint": error.hint, "source": request.source.value})
            log.warning(text, hint=error.hint)

    def _begin(self, running: Running, ordered: Request, source: Source) -> str:
        position_set = ordered.job.settings.procedure.position_set
        self._board.begins(running.run_id, ordered.kind.name, source, position_set)
        self._launch(running, lambda: self._house.carry_out(ordered))
        return running.run_id

    def _slot_minutes(self, request: StartRequest) -> float | None:
        """Machine time there is; None: any. Without consent, whether anything may begin now is decided here."""
        self.reconcile()
        slots = [request.slot_minutes, None if request.consent else self._orders.permitted_minutes(self.settings)]
        return min((slot for slot in slots if slot is not None), default=None)

    # ------------------------------------------------------------------ the run's thread

    def _launch(self, running: Running, carry_out: Callable[[], RunResult]) -> None:
        threading.Thread(target=self._work, args=(running.run_id, carry_out), name=running.run_id, daemon=True).start()

    def _work(self, run_id: str, carry_out: Callable[[], RunResult]) -> None:
        self._house.health.begins()
        with structlog.contextvars.bound_contextvars(run_id=run_id):
            try:
                ended = carry_out()
            except VolcalError as error:
                self._conclude(_end_of(error), error)
            except BaseException as defect:  # the machine must be free again, and the defect seen
                log.exception("defect in the agent")
                self._conclude(RunState.FAULTED, defect)
            else:
                self._board.ended(ended.outcome)
                self._conclude(ended.outcome.state, ended.error)
                self._house.reports.wanted(run_id)

    def _conclude(self, state: RunState, error: BaseException | None) -> None:
        standing = self._standing()
        with self._changed:
            self._board.stands(standing)
            self._house.scenes.forget()
            if error is not None:
                self._board.alarm(alarm_of(error))
            if state in allowed_requests.STICKY:
                self._reconciled = False
            self._running = None
            self._board.enter(state, str(error) if error is not None else state.value)
            self._changed.notify_all()

    # ------------------------------------------------------------------

    def _standing(self) -> Standing:
        try:
            return self._house.journal_state.standing(self.settings, self._house.config.parent)
        except Exception:  # figures to look at: the machine must be free again without them
            log.exception("what the machine was left as is not known")
            return Standing()

    def _require(self, what: str, why: str) -> None:
        status = self._board.status()
        if what not in status.may:
            raise UserError(f"{what} makes no sense now: the state is {status.state.value}", hint=why)

    def _on_running(self, action: Callable[[Running], None], text: str) -> None:
        with self._changed:
            if self._running is not None:
                action(self._running)
                self._house.bulletin.publish("note", text)
                log.info(text)


def _end_of(error: VolcalError) -> RunState:
    """Of a run that never came to be: nothing has moved."""
    return RunState.REFUSED if isinstance(error, (PlanRefused, UserError)) else RunState.FAULTED
