"""Kind of run `try`, with which a machine is commissioned: one ball is located and measured, and probe, latch and axes
are checked on it. The run writes no compensation table."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from agent.execution.states import RunState
from agent.execution.steps import Plan
from agent.planning.job import Job
from agent.planning.preflight import run_preflight
from agent.probing.run_plan import MeasuredPositions
from agent.results.trial_report import trial_report
from agent.runs.guarded_run import GuardedRun
from agent.runs.planned_run import PlannedRun, StartConditions
from agent.settings.schema import Settings


def with_checks(settings: Settings) -> Settings:
    """Return settings in which the checks are enabled for which a trial is made: repeatability of the probe, and delay
    of its latch."""
    return settings.model_copy(
        update={"probe_check": settings.probe_check.model_copy(update={"enabled": True, "latch_delay": True})}
    )


@dataclass(frozen=True)
class OneBallTrial:
    """Kind of run that makes the checks before a calibration, and nothing else. They are made on one ball. The settings
    of its job must enable at least one of them, as those of `with_checks` do."""

    name: str = "try"

    def plan(self, job: Job, start: StartConditions, watch: Callable[[], None]) -> PlannedRun:
        preflight = run_preflight(job, start.start_mm, _checks_only, watch, with_proof=False)
        return PlannedRun(job, self, start, preflight, lambda context: TrialRun(job, context))


class TrialRun(GuardedRun):
    """Run that measures one ball and reports what the checks on it say. It does not change the compensation."""

    def _work(self) -> None:
        self._begin()
        prepared = self._prepare_probe()
        self._tracker.enter(RunState.IDENTIFYING)
        assert prepared.datum is not None  # noqa: S101  the checks are not empty
        report = self.progress.trial = trial_report(prepared, prepared.datum)
        self._journal.decision("try", report.as_json())
        self._tracker.enter(RunState.COMPLETE, "; ".join(report.warnings))


def _checks_only(job: Job) -> Plan[tuple[MeasuredPositions, MeasuredPositions]]:
    """Return the procedure of a trial for the preflight. It measures no positions."""
    prepared = yield from job.preparation_plan()
    nothing = MeasuredPositions((), (), 0, prepared.standing_at, {}, prepared.placed)
    return nothing, nothing
