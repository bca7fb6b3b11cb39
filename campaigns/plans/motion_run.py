"""Run kind with all motions and measurements of a calibration, but without identification and without
writing a table.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from agent.runs.guarded_run import GuardedRun

from agent.execution.states import RunState
from agent.planning.job import Job
from agent.planning.preflight import PreflightResult, run_preflight, whole_procedure
from agent.runs.planned_run import PlannedRun, StartConditions
from drivers.clock import VirtualClock


class MotionOnlyRun(GuardedRun):
    """Run of all motions and measurements of a calibration, without identification and without writing a table. It
    begins with the check of permissions and ends like every other run.
    """

    def _work(self) -> None:
        self._begin()
        self.progress.measured, self.progress.verified = self._engine.run(whole_procedure(self._job))
        self._tracker.enter(RunState.IDENTIFYING)
        self._tracker.enter(RunState.COMPLETE)


@dataclass
class MotionOnlyKind:
    """Run kind whose preflight is computed once, from the position at which the first run starts.

    A second run of the same plan uses the same preflight and must therefore start at the same position.
    """

    name: str = "moving"

    def __post_init__(self) -> None:
        self.preflight: PreflightResult | None = None

    def plan(self, job: Job, start: StartConditions, watch: Callable[[], None]) -> PlannedRun:
        if self.preflight is None:
            self.preflight = run_preflight(job, start.start_mm)
        return PlannedRun(job, self, start, self.preflight, lambda context: MotionOnlyRun(job, context))


class AlarmClock(VirtualClock):
    """Virtual clock that calls functions at given instants.

    The method `at(instant_s, action)` registers a function `action` that is called once the clock has reached
    `instant_s`. If the function `watch` is set, `watch(before_s, after_s)` is called before every advance of the clock
    from `before_s` to `after_s`.
    """

    def __init__(self) -> None:
        super().__init__()
        self._alarms: list[tuple[float, Callable[[], None]]] = []
        self.watch: Callable[[float, float], None] | None = None

    def at(self, instant_s: float, action: Callable[[], None]) -> None:
        self._alarms.append((instant_s, action))

    def advance_to(self, instant_s: float) -> None:
        if self.watch is None and not self._alarms:
            super().advance_to(instant_s)
            return
        before = self.now()
        if self.watch is not None and instant_s > before:
            self.watch(before, instant_s)
        super().advance_to(instant_s)
        due = [alarm for alarm in self._alarms if alarm[0] <= instant_s]
        self._alarms = [alarm for alarm in self._alarms if alarm[0] > instant_s]
        for _, action in due:
            action()
