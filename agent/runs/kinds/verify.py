"""Kind of run `verify`.

A few positions are measured with active compensation and compared with the last accepted night (the last run whose
estimate was accepted as the reference). The run writes no compensation table.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from agent.execution.states import RunState
from agent.planning.job import Job
from agent.planning.preflight import run_preflight
from agent.runs.guarded_run import GuardedRun
from agent.runs.kinds.calibrate import nights_since
from agent.runs.kinds.check_measurement import judge_measurement, measure, require_table_of
from agent.runs.kinds.drift_check import Judge
from agent.runs.kinds.night_plan import (
    VERIFICATION,
    NightPlan,
    job_at_station,
    station_of,
    verification_only,
    verification_plan,
)
from agent.runs.kinds.position_choice import PositionChooser
from agent.runs.planned_run import PlannedRun, StartConditions
from agent.runs.reference_state import require_reference
from agent.runs.run_context import RunContext


@dataclass(frozen=True)
class Verification:
    """Kind of run that only verifies the machine.

    `station` is the station of the artefact; if it is None, the station is taken from the settings. `nights` is the
    number of nights since the last accepted night (the last run whose estimate was accepted as the reference); if it is
    None, the number is computed from the date.
    """

    station: int | None = None
    nights: float | None = None
    name: str = "verify"

    def plan(self, job: Job, start: StartConditions, watch: Callable[[], None]) -> PlannedRun:
        station = station_of(job, self.station)
        reference = require_reference(job, start.run)
        judge = Judge(job, reference, nights_since(reference, self.nights, start.at))
        plan = verification_plan(PositionChooser(job_at_station(job, station), station), judge)
        own = plan.job(job)
        preflight = run_preflight(own, start.start_mm, verification_only(plan), watch)
        return PlannedRun(own, self, start, preflight, lambda context: VerifyRun(own, context, judge, plan))


class VerifyRun(GuardedRun):
    """Run that measures a few positions and compares them with their prediction from the last accepted night. It does
    not change the compensation."""

    def __init__(self, job: Job, context: RunContext, judge: Judge, plan: NightPlan) -> None:
        super().__init__(job, context)
        self._judge = judge
        self._plan = plan

    def _work(self) -> None:
        require_table_of(self._judge.reference, self._begin())
        self._prepare_probe()
        job, plan = self._job, self._plan
        measured = measure(self._engine, plan, VERIFICATION, plan.first, job, self.rules)
        self.progress.measured = measured
        self._tracker.enter(RunState.IDENTIFYING)
        report = self.progress.night = judge_measurement(self._judge, plan, job, measured, self._correction).report
        self._journal.decision("verify", report.as_json())
        self._tracker.enter(RunState.COMPLETE, report.reason or report.decision.value)
