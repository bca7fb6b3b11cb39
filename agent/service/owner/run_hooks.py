"""Hooks (functions that a run calls) that connect the service to its runs, and the limit on the machine time of
a run."""

from __future__ import annotations

from dataclasses import dataclass

import structlog

from agent.errors import PlanRefused
from agent.execution.run_state import Announcement
from agent.execution.states import RunState
from agent.execution.steps import Step
from agent.planning.job import Job
from agent.planning.preflight import PreflightResult
from agent.runs.run_context import RunHooks
from agent.runs.run_request import RunRequest
from agent.service.allowed_requests import AT_REST
from agent.service.owner.owner_parts import OwnerParts
from agent.service.owner.questions import Questions
from agent.service.owner.run_mailbox import RunMailbox
from agent.service.state.reports import no_report_yet
from agent.settings.schema import ClockSettings, NightlySettings


@dataclass(frozen=True)
class RunHooksFactory:
    """Factory of the hooks (functions that a run calls) that connect a run to the status board of the service, the
    monitor of the run's thread, the time limit and the questions asked at the endpoints."""

    parts: OwnerParts
    questions: Questions

    def hooks(
        self, run: RunMailbox, clock: ClockSettings, *, attended: bool, slot_minutes: float | None = None
    ) -> RunHooks:
        """Return the hooks of `run`.

        `attended` is True if a person can answer questions. `slot_minutes` limits the machine time in min; if it is
        None, there is no limit. Raise ConfigurationError if the clock cannot be created.
        """
        parts = self.parts

        def preflight_passed(job: Job, preflight: PreflightResult) -> None:
            parts.live_view.preflight_passed(run.run_id, job, preflight)
            require_within(preflight, slot_minutes)

        return RunHooks(
            announce=self._announce,
            attach=run.attach,
            observe=self._observe,
            preflight_passed=preflight_passed,
            return_begins=self._begin_return,
            lock=parts.ownership.for_run,
            devices=parts.machine.devices_for_run(clock, self.questions, attended=attended),
            reports=no_report_yet,
        )

    def _announce(self, announcement: Announcement) -> None:
        if announcement.kind == "state":
            state = RunState(announcement.data["state"])
            if state in AT_REST:
                self.parts.health.begin_conclusion()
            elif state is RunState.RESUMING:  # a resumption that discards a position moves again after its first end
                self.parts.health.begin_run()
        self.parts.board.on_announcement(announcement)

    def _begin_return(self) -> None:
        self.parts.health.begin_return()
        self.parts.board.begin_return()

    def _observe(self, step: Step, result: object) -> None:
        self.parts.health.beat()
        structlog.contextvars.bind_contextvars(step=step.key)
        self.parts.board.on_step(step, result)


def require_within(preflight: PreflightResult, slot_minutes: float | None) -> None:
    """Raise PlanRefused if the run takes longer than `slot_minutes`, the available machine time in min. If
    `slot_minutes` is None, there is no limit."""
    needed = preflight.longest_minutes
    if slot_minutes is not None and needed > slot_minutes:
        raise PlanRefused(
            f"the run takes {needed:.0f} min of machine time, {slot_minutes:.0f} min are available",
            hint="use a longer slot, fewer stations or a smaller position set",
        )


def night_slot(request: RunRequest, nightly: NightlySettings, available_minutes: float | None) -> float:
    """Return the machine time, in min, that is available to a nightly run.

    This time is taken from the request for the run or, if the request does not state it, from the settings. It is
    limited to `available_minutes`, or not limited if `available_minutes` is None.
    """
    slot = nightly.slot_minutes if request.slot_minutes is None else request.slot_minutes
    return slot if available_minutes is None else min(slot, available_minutes)
