"""A full calibration that a night has asked for: done in a slot that permits it, waited for in one that does not."""

from __future__ import annotations

from dataclasses import dataclass, replace

from agent.errors import GateRefused, PlanRefused
from agent.execution.states import RunState
from agent.planning.job import Job
from agent.planning.preflight import run_preflight
from agent.results.run_outcome import Decision, NightReport
from agent.runs.calibration import CalibrationRun
from agent.runs.consent import Consent
from agent.runs.guarded_run import GuardedRun, Means
from agent.runs.kinds.check_measurement import judged, measure, require_table_of
from agent.runs.kinds.drift_check import Judge
from agent.runs.kinds.kind import Ready
from agent.runs.kinds.night_plan import LOOK, NightPlan, looking_plan, only_looking
from agent.runs.kinds.position_choice import Chooser
from agent.runs.reference_state import FullNeeded
from agent.runs.start_conditions import Outset


@dataclass(frozen=True)
class Slot:
    """Machine minutes of a night, its reserve included, and whether a full calibration may fill it."""

    minutes: float
    full_allowed: bool
    reserve: float

    def holds(self, minutes: float) -> bool:
        return minutes + self.reserve <= self.minutes


def ready_for_full(here: Job, station: int, judge: Judge, slot: Slot, pending: FullNeeded, outset: Outset) -> Ready:
    """The full calibration that an earlier night has asked for; where it cannot be tonight, a verification."""
    if slot.full_allowed:
        preflight = run_preflight(here, outset.start_mm, watch=outset.watch)
        if slot.holds(preflight.machine_minutes):
            return Ready(here, preflight, lambda means: FullRun(here, means, judge, station, pending))
    plan = looking_plan(Chooser(here, station), judge)
    own = plan.job(here)
    preflight = run_preflight(own, outset.start_mm, only_looking(plan), outset.watch)
    if not slot.holds(preflight.machine_minutes):
        raise PlanRefused(
            f"the verification takes {preflight.machine_minutes:.1f} min, the slot has {slot.minutes:g}",
            hint=f"a full calibration is needed since run {pending.run_id}: give a slot for it",
        )
    return Ready(own, preflight, lambda means: WaitingRun(own, means, judge, plan, pending))


class FullRun(GuardedRun):
    """The full calibration that a night asked for, in a slot that it was permitted."""

    def __init__(self, job: Job, means: Means, judge: Judge, station: int, pending: FullNeeded) -> None:
        super().__init__(job, means)
        self._means = means
        self._judge = judge
        self._station = station
        self._pending = pending

    def _work(self) -> None:
        self._begin()
        self._prepare_probe()
        report = NightReport(
            Decision.FULL_DONE,
            since=self._judge.last.run_id,
            nights=self._judge.nights,
            station=self._station,
            positions=0,
            reason=self._pending.reason,
            ve_before_um=self._judge.before_um,
        )
        calibrate_in_full(self, self._job, self._means, self._judge, report)


class WaitingRun(GuardedRun):
    """A full calibration is needed and not permitted: look, tell, write nothing."""

    def __init__(self, job: Job, means: Means, judge: Judge, plan: NightPlan, pending: FullNeeded) -> None:
        super().__init__(job, means)
        self._judge = judge
        self._plan = plan
        self._pending = pending

    def _work(self) -> None:
        require_table_of(self._judge.last, self._begin())
        self._prepare_probe()
        measured = measure(self._engine, self._plan, LOOK, self._plan.first, self._job, self._rules)
        self.progress.measured = measured
        self._tracker.enter(RunState.IDENTIFYING)
        report = judged(self._judge, self._plan, self._job, measured, self._correction).report
        self.progress.night = replace(report, decision=Decision.FULL_NEEDED, reason=self._pending.reason)
        self._journal.decision("night", self.progress.night.as_json())
        raise refusal_until_full(f"{self._pending.reason} (run {self._pending.run_id})")


def calibrate_in_full(run: GuardedRun, job: Job, means: Means, judge: Judge, report: NightReport) -> None:
    """From now on `run` is a full calibration with all that it has reached; consent was given with the permission."""
    full = CalibrationRun(job, means, judge.last, judge.nights, Consent.GIVEN)
    full.progress = run.progress
    full.progress.job = job
    full.progress.night = report
    full.calibrate(report.station)
    proof = full.progress.proof
    if proof is not None and not proof.accepted:
        full.progress.night = replace(report, decision=Decision.RESTORED, reason=proof.reason)


def refusal_until_full(reason: str) -> GateRefused:
    return GateRefused(
        f"a full calibration is needed: {reason}", hint="the next slot with --full-allowed that is long enough does it"
    )
