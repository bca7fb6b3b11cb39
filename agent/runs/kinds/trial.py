"""Kind of run `try`, with which a machine is commissioned: one ball is located and measured, and probe, latch and axes
are checked on it. The run writes no compensation table."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

from agent.errors import PlanRefused
from agent.execution.journal import RunJournal
from agent.execution.states import RunState
from agent.execution.steps import Conclude, Enter, RunPlan, Step
from agent.planning.job import Job
from agent.probing.ball import FittedBall
from agent.probing.homing_touches import touch_after_homings
from agent.results.decision_kinds import TRIAL
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
    of its job must enable at least one of them, as those of `with_checks` do.

    `homings` is the number of times that the axes are homed and the ball is measured again, for the scatter of the
    homing; 0 if it is not measured.
    """

    name: str = "try"
    homings: int = 0

    def plan(self, job: Job, start: StartConditions, watch: Callable[[], None]) -> PlannedRun:
        """Plan the trial. Raises PlanRefused if the axes are to be homed, but cannot be homed on command or would move
        the probe into the artefact."""
        reason = start.no_homing or _towards_artefact(job, start)
        if self.homings and reason:
            raise PlanRefused(
                f"the scatter of the homing cannot be measured: {reason}", hint="nothing was moved; leave out --homing"
            )
        planned = plan_run(job, self, start, lambda: trial(job, self.homings), watch)
        return replace(planned, too_late=_not_resumed) if self.homings else planned


def _towards_artefact(job: Job, start: StartConditions) -> str:
    """Return the reason, in words, why a homing would move the probe into the artefact; empty if it would not."""
    axis = job.rules.retreat.retreat_axis
    direction, stylus = start.homing_directions[axis], float(job.rules.probing.stylus_axis[axis])
    if direction * stylus <= 0.0:
        return ""
    end = "upper" if direction > 0 else "lower"
    return f"{'XYZ'[axis]} homes at its {end} end, to which the stylus points; the probe would move into the artefact"


def _not_resumed(_: Step, __: float) -> PlanRefused:
    """Return the refusal to resume a trial whose axes may have been homed or moved since it was interrupted."""
    return PlanRefused(
        "a trial that measures the homing is not resumed, because the axes may have been homed meanwhile",
        hint="end it with `volcal resume --give-up`, then start it again",
    )


def trial(job: Job, homings: int = 0) -> RunPlan:
    """Return the plan that measures one ball and reports what the checks on it say. The axes are homed `homings` times
    afterwards, and the ball is measured after each homing."""
    found = yield from found_compensation()
    prepared = (yield from prepared_run(job, found)).prepared
    datum = prepared.datum
    after_homings: tuple[FittedBall, ...] = ()
    if homings and datum is not None:
        after_homings = yield from touch_after_homings(datum, prepared.rules, homings)
    yield Enter("state/identifying", RunState.IDENTIFYING)

    def report_of() -> TrialReport:
        assert datum is not None  # noqa: S101  the checks are not empty
        return trial_report(prepared, datum, after_homings)

    def record(journal: RunJournal, made: TrialReport) -> None:
        journal.decision(TRIAL, made.as_json())

    report = yield Conclude("try/report", report_of, None, record)
    yield from complete(lambda: "; ".join(report.warnings))
    return None
