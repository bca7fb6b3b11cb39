"""Kind of run `try`, with which a machine is commissioned: one ball is located and measured, and probe, latch and axes
are checked on it. The run writes no compensation table."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from agent.execution.journal import RunJournal
from agent.execution.states import RunState
from agent.execution.steps import Conclude, Enter, RunPlan
from agent.planning.job import Job
from agent.results.trial_report import TrialReport, trial_report
from agent.runs.kinds.run_parts import complete, found_compensation, prepared_run
from agent.runs.planned_run import PlannedRun, StartConditions, plan_run
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
        return plan_run(job, self, start, lambda: trial(job), watch)


def trial(job: Job) -> RunPlan:
    """Return the plan that measures one ball and reports what the checks on it say."""
    found = yield from found_compensation()
    prepared = (yield from prepared_run(job, found)).prepared
    yield Enter("state/identifying", RunState.IDENTIFYING)

    def report_of() -> TrialReport:
        assert prepared.datum is not None  # noqa: S101  the checks are not empty
        return trial_report(prepared, prepared.datum)

    def record(journal: RunJournal, made: TrialReport) -> None:
        journal.decision("try", made.as_json())

    report = yield Conclude("try/report", report_of, None, record)
    yield from complete(lambda: "; ".join(report.warnings))
    return None
