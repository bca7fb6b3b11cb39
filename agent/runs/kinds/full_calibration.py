"""Full calibration that an earlier night found necessary. Until a slot (machine time available for a night) permits the
calibration, all nightly runs only verify the machine."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

from agent.errors import GateRefused, PlanRefused
from agent.execution.states import RunState
from agent.planning.job import Job
from agent.planning.preflight import run_preflight
from agent.results.run_outcome import Decision, NightReport
from agent.runs.calibration import CalibrationRun
from agent.runs.consent import Consent
from agent.runs.guarded_run import GuardedRun
from agent.runs.kinds.check_measurement import judge_measurement, measure, require_table_of
from agent.runs.kinds.drift_check import Judge
from agent.runs.kinds.night_plan import VERIFICATION, NightPlan, verification_only, verification_plan
from agent.runs.kinds.position_choice import PositionChooser
from agent.runs.planned_run import Kind, PlannedRun, StartConditions
from agent.runs.reference_state import FullCalibrationNeed
from agent.runs.run_context import RunContext


@dataclass(frozen=True)
class Slot:
    """Machine time available for a night (slot).

    `minutes` is the length of the slot, of which `reserve` minutes must remain unused. `full_allowed` is True if a full
    calibration is permitted.
    """

    minutes: float
    full_allowed: bool
    reserve: float

    def holds(self, minutes: float) -> bool:
        return minutes + self.reserve <= self.minutes


@dataclass(frozen=True, eq=False)
class PendingCalibration:
    """Nightly run for which an earlier run has requested a full calibration.

    `here` is the job with the artefact at `station`. `pending` is the recorded decision that requires the calibration.
    `slot` is the machine time available for the night.
    """

    kind: Kind
    here: Job
    station: int
    judge: Judge
    slot: Slot
    pending: FullCalibrationNeed

    def plan(self, start: StartConditions, watch: Callable[[], None]) -> PlannedRun:
        """Plan the full calibration. If the slot (machine time available for a night) does not permit it or is too
        short for it, plan a verification instead.

        Raises PlanRefused if the slot is too short even for the verification.
        """
        return self._full(start, watch) or self._verification(start, watch)

    def _full(self, start: StartConditions, watch: Callable[[], None]) -> PlannedRun | None:
        if not self.slot.full_allowed:
            return None
        preflight = run_preflight(self.here, start.start_mm, watch=watch)
        if not self.slot.holds(preflight.machine_minutes):
            return None
        return PlannedRun(
            self.here,
            self.kind,
            start,
            preflight,
            lambda context: FullCalibrationRun(self.here, context, self.judge, self.station, self.pending),
        )

    def _verification(self, start: StartConditions, watch: Callable[[], None]) -> PlannedRun:
        slot, pending = self.slot, self.pending
        plan = verification_plan(PositionChooser(self.here, self.station), self.judge)
        own = plan.job(self.here)
        preflight = run_preflight(own, start.start_mm, verification_only(plan), watch)
        if not slot.holds(preflight.machine_minutes):
            raise PlanRefused(
                f"the verification takes {preflight.machine_minutes:.1f} min, the slot has {slot.minutes:g}",
                hint=f"a full calibration is needed since run {pending.run_id}: give a slot for it",
            )
        return PlannedRun(
            own,
            self.kind,
            start,
            preflight,
            lambda context: CalibrationPendingRun(own, context, self.judge, plan, pending),
        )


class FullCalibrationRun(GuardedRun):
    """Run that makes the full calibration that an earlier night found necessary. It is used if the slot (machine time
    available for a night) permits it."""

    def __init__(self, job: Job, context: RunContext, judge: Judge, station: int, pending: FullCalibrationNeed) -> None:
        super().__init__(job, context)
        self._context = context
        self._judge = judge
        self._station = station
        self._pending = pending

    def _work(self) -> None:
        self._begin()
        self._prepare_probe()
        report = NightReport(
            Decision.FULL_DONE,
            since=self._judge.reference.run_id,
            nights=self._judge.nights,
            station=self._station,
            positions=0,
            reason=self._pending.reason,
            ve_before_um=self._judge.before_um,
        )
        calibrate_in_full(self, self._job, self._context, self._judge, report)


class CalibrationPendingRun(GuardedRun):
    """Run that makes a verification because the required full calibration cannot be done in this slot (machine time
    available for a night). It writes no compensation table."""

    def __init__(
        self, job: Job, context: RunContext, judge: Judge, plan: NightPlan, pending: FullCalibrationNeed
    ) -> None:
        super().__init__(job, context)
        self._judge = judge
        self._plan = plan
        self._pending = pending

    def _work(self) -> None:
        require_table_of(self._judge.reference, self._begin())
        self._prepare_probe()
        measured = measure(self._engine, self._plan, VERIFICATION, self._plan.first, self._job, self.rules)
        self.progress.measured = measured
        self._tracker.enter(RunState.IDENTIFYING)
        report = judge_measurement(self._judge, self._plan, self._job, measured, self._correction).report
        self.progress.night = replace(report, decision=Decision.FULL_NEEDED, reason=self._pending.reason)
        self._journal.decision("night", self.progress.night.as_json())
        raise refusal_until_full(f"{self._pending.reason} (run {self._pending.run_id})")


def calibrate_in_full(run: GuardedRun, job: Job, context: RunContext, judge: Judge, report: NightReport) -> None:
    """Continue `run` as a full calibration of `job`. The results that `run` has so far are kept.

    The operator is not asked for consent to a table for the changed machine, because the permission for a full
    calibration includes this consent.
    """
    full = CalibrationRun(job, context, judge.reference, judge.nights, Consent.GIVEN, changed=True)
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
