"""What `agent.runs.session` is handed for a run of the service."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import structlog

from agent.execution.run_state import Announcement
from agent.execution.states import RunState
from agent.execution.steps import Step
from agent.planning.job import Job
from agent.runs.kinds.kind import Kind, Ready
from agent.runs.resume.resume import ResumeRequest
from agent.runs.session import Request
from agent.service.allowed_requests import AT_REST
from agent.service.control import Source
from agent.service.owner.owner_parts import Household
from agent.service.owner.questions import Questions
from agent.service.owner.request_translation import require_within
from agent.service.owner.run_mailbox import Running
from agent.service.owner.unattended import minutes_until_end, require_permission, require_warm
from agent.service.state.reports import none_yet
from agent.settings.schema import Settings


@dataclass(frozen=True)
class Orders:
    """Every run is heard by the board, seen by the watchdog, held to its slot, and asks through the doors."""

    house: Household
    questions: Questions

    def anew(
        self,
        running: Running,
        job: Job,
        kind: Kind,
        asked: Mapping[str, object],
        *,
        attended: bool,
        slot_minutes: float | None = None,
    ) -> Request:
        house = self.house

        def passed(ready: Ready) -> None:
            house.scenes.preflight_passed(running.run_id, ready)
            require_within(ready, slot_minutes)

        return Request(
            job=job,
            base=house.config.parent,
            listener=self._hear,
            interrupts=running.attach,
            kind=kind,
            clock=house.devices.make_clock(job.settings.clock),
            rig=house.devices.asking(self.questions, attended=attended),
            run_id=running.run_id,
            asked=asked,
            lock=house.ownership.for_run,
            observer=self._observe,
            passed=passed,
            reports=none_yet,
        )

    def going_on(self, running: Running, source: Source, settings: Settings) -> ResumeRequest:
        house = self.house
        return ResumeRequest(
            state_directory=settings.state_directory,
            listener=self._hear,
            interrupts=running.attach,
            clock=house.devices.make_clock(settings.clock),
            rig=house.devices.asking(self.questions, attended=True),
            asked={"source": source.value, "resumed": True},
            lock=house.ownership.for_run,
            observer=self._observe,
            passed=lambda ready: house.scenes.preflight_passed(running.run_id, ready),
            reports=none_yet,
        )

    def permitted_minutes(self, settings: Settings) -> float | None:
        """Minutes until the permitted hours end, None for any number. Raises where nothing may begin by itself now."""
        service, circumstances = settings.service, self.house.circumstances()
        left = minutes_until_end(circumstances, service.hours)
        require_warm(circumstances, service.warm_up_minutes)
        require_permission(self.house.devices.machine_status(settings, self.house.config.parent))
        return left

    def _hear(self, announcement: Announcement) -> None:
        if announcement.kind == "state" and RunState(announcement.data["state"]) in AT_REST:
            self.house.health.concludes()
        self.house.board.hear(announcement)

    def _observe(self, step: Step, result: object) -> None:
        self.house.health.beat()
        structlog.contextvars.bind_contextvars(step=step.key)
        self.house.board.see(step, result)
