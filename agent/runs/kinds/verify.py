"""`verify`: a few positions with the compensation active against the last accepted night; nothing is written."""

from __future__ import annotations

from dataclasses import dataclass

from agent.execution.states import RunState
from agent.planning.job import Job
from agent.planning.preflight import run_preflight
from agent.runs.guarded_run import GuardedRun, Means
from agent.runs.kinds.check_measurement import judged, measure, require_table_of
from agent.runs.kinds.drift_check import Judge
from agent.runs.kinds.kind import Ready, nights_since
from agent.runs.kinds.night_plan import LOOK, NightPlan, looking_plan, only_looking, standing, station_of
from agent.runs.kinds.position_choice import Chooser
from agent.runs.reference_state import require_accepted
from agent.runs.start_conditions import Outset


@dataclass(frozen=True)
class Verification:
    """`station` where the artefact stands, None: as the settings say; `nights` since the last accepted one, None: by
    the calendar."""

    station: int | None = None
    nights: float | None = None
    name: str = "verify"

    def ready(self, job: Job, outset: Outset) -> Ready:
        last = require_accepted(job, outset.run)
        station = station_of(job, self.station)
        judge = Judge(job, last, nights_since(last, self.nights, outset.at))
        plan = looking_plan(Chooser(standing(job, station), station), judge)
        own = plan.job(job)
        preflight = run_preflight(own, outset.start_mm, only_looking(plan), outset.watch)
        return Ready(own, preflight, lambda means: VerifyRun(own, means, judge, plan))


class VerifyRun(GuardedRun):
    """Measures, judges, and leaves everything as it was."""

    def __init__(self, job: Job, means: Means, judge: Judge, plan: NightPlan) -> None:
        super().__init__(job, means)
        self._judge = judge
        self._plan = plan

    def _work(self) -> None:
        require_table_of(self._judge.last, self._begin())
        self._prepare_probe()
        job, plan = self._job, self._plan
        measured = measure(self._engine, plan, LOOK, plan.first, job, self._rules)
        self.progress.measured = measured
        self._tracker.enter(RunState.IDENTIFYING)
        report = self.progress.night = judged(self._judge, plan, job, measured, self._correction).report
        self._journal.decision("verify", report.as_json())
        self._tracker.enter(RunState.COMPLETE, report.reason or report.decision.value)
