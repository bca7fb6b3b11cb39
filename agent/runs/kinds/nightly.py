"""Kind of run `nightly`.

The run verifies the machine and measures the positions that reduce the uncertainty most. It then combines the result
with the estimate of earlier nights.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

from agent.errors import MeasurementFault, PlanRefused
from agent.execution.states import RunState
from agent.execution.steps import Step
from agent.files import translated
from agent.planning.job import Job
from agent.planning.preflight import PreflightResult, Procedure, run_preflight
from agent.probing.position import MeasuredBall
from agent.probing.repeated_positions import join_measured
from agent.probing.run_plan import MeasuredPositions
from agent.results.estimation import EstimationResult, estimate_with_table
from agent.results.gates import Gate, change_gate, estimate_gates, shape_gates
from agent.results.observations import positions_named
from agent.results.run_outcome import Decision, NightReport, Proof
from agent.results.table_replacement import ExpectedGain
from agent.results.thermal_drift import balls_for_estimate, fusion_options, observations_with_drift
from agent.runs.calibration import CalibrationRun
from agent.runs.change_since_reference import change_since, fit_of_night
from agent.runs.consent import Consent
from agent.runs.kinds.calibrate import nights_since
from agent.runs.kinds.check_measurement import judge_measurement, measure, require_table_of
from agent.runs.kinds.drift_check import Judge, Judgement, with_fit
from agent.runs.kinds.full_calibration import PendingCalibration, Slot, calibrate_in_full, refusal_until_full
from agent.runs.kinds.night_plan import (
    FURTHER,
    MIN_FUSED_POSITIONS,
    VERIFICATION,
    NightPlan,
    additional_positions,
    job_at_station,
    night_plan,
    positions_in,
    station_of,
)
from agent.runs.kinds.position_choice import PositionChooser
from agent.runs.planned_run import PlannedRun, StartConditions
from agent.runs.reference_state import (
    full_calibration_need,
    record_accepted,
    record_full_calibration_need,
    require_reference,
)
from agent.runs.run_context import RunContext
from twin.artefact.position_set import Position
from twin.monitoring.night_fit import NightFit
from twin.units import S_PER_MIN

DIAGNOSIS = "diagnosis"
SUSPECTS = 8
"""Largest number of suspected errors between which a diagnosis discriminates."""


@dataclass(frozen=True)
class Night:
    """Kind of run that verifies the machine and improves the estimate.

    `slot_minutes` is the length of the slot (machine time available for a night). `full_allowed` is True if, in this
    night, a person moves the artefact between stations and consents to a table for a changed machine. If `slot_minutes`
    or `full_allowed` is None, it is taken from the settings. `station` is the station of the artefact; if it is None,
    the station is taken from the settings. `nights` is the number of nights since the last accepted night; if it is
    None, the number is computed from the date.
    """

    slot_minutes: float | None = None
    full_allowed: bool | None = None
    station: int | None = None
    nights: float | None = None
    name: str = "nightly"

    def plan(self, job: Job, start: StartConditions, watch: Callable[[], None]) -> PlannedRun:
        chosen = job.settings.nightly
        station = station_of(job, self.station)
        reference = require_reference(job, start.run)
        here = job_at_station(job, station)
        judge = Judge(job, reference, nights_since(reference, self.nights, start.at))
        slot = Slot(
            chosen.slot_minutes if self.slot_minutes is None else self.slot_minutes,
            chosen.full_allowed if self.full_allowed is None else self.full_allowed,
            chosen.reserve_minutes,
        )
        pending = full_calibration_need(job.settings.state_directory, start.run)
        if pending is not None:
            return PendingCalibration(self, here, station, judge, slot, pending).plan(start, watch)
        chooser = PositionChooser(here, station)
        plan, preflight = night_plan(chooser, judge, slot.minutes, start.start_mm, watch)
        own = plan.job(job)
        return PlannedRun(
            own,
            self,
            start,
            preflight,
            lambda context: NightlyRun(own, context, judge, plan, chooser, preflight, slot),
        )


class NightlyRun(CalibrationRun):
    """Run of a night. It verifies the machine, measures further positions in the rest of the slot (machine time
    available for a night), and combines the measurements with the earlier estimate. If the expected gain in accuracy is
    large enough, it also writes an updated compensation table and proves it."""

    def __init__(
        self,
        job: Job,
        context: RunContext,
        judge: Judge,
        plan: NightPlan,
        chooser: PositionChooser,
        preflight: PreflightResult,
        slot: Slot,
    ) -> None:
        super().__init__(job, context, judge.reference, judge.nights, Consent.REFUSED)
        self._context = context
        self._judge = judge
        self._plan = plan
        self._chooser = chooser
        self._preflight_result = preflight
        self._slot = slot
        self._began_s = self._clock.now()
        self._fit: NightFit | None = None

    # ------------------------------------------------------------------ measuring

    def _work(self) -> None:
        plan = self._plan
        require_table_of(self._judge.reference, self._begin())
        self._prepare_probe()
        measured = self._measure(VERIFICATION, plan.first)
        judgement = self._judged(measured)
        if judgement.within:
            measured, judgement = self._use_rest(measured, judgement)
        if not judgement.within:
            self._out_of_limits(measured, judgement)
            return
        self._tracker.enter(RunState.IDENTIFYING)
        self._fuse(measured, judgement.report)

    def _use_rest(self, measured: MeasuredPositions, judgement: Judgement) -> tuple[MeasuredPositions, Judgement]:
        further = self._still_fitting()
        if not further:
            return measured, judgement
        measured = join_measured(measured, self._measure(FURTHER, further, measured))
        return measured, self._judged(measured)

    def _still_fitting(self) -> tuple[Position, ...]:
        """Return the further positions for which time is left after reserving the time of the proof."""
        further = list(self._plan.further)
        needed = self._planned_minutes_after(VERIFICATION)
        while further and needed > self._left_minutes:
            needed -= self._chooser.minutes([further.pop()])
        return tuple(further)

    def too_late(self, following: Step) -> PlanRefused | None:
        """Return an error if too little of the slot (machine time available for a night) is left to resume the run, and
        None otherwise. The time of an interruption counts as part of the slot.

        The time left must suffice for the rest of the verification at the beginning of the run, because an incomplete
        verification is useless. `following` is the first step of the resumed run that moves the machine.
        """
        at_s = self._preflight_result.timeline.get(following.key)
        needed = 0.0 if at_s is None else (self._preflight_result.machine_seconds - at_s) / S_PER_MIN
        needed -= self._planned_minutes_after(VERIFICATION)
        if max(needed, 0.0) > self._left_minutes or self._left_minutes <= 0.0:
            return PlanRefused(
                f"the night cannot be resumed: {self._left_minutes:.1f} min are left of its slot of "
                f"{self._slot.minutes:g} min, the verification alone needs {max(needed, 0.0):.1f} min more",
                hint="wait for the next night; what was measured stays in the journal",
            )
        return None

    def _planned_minutes_after(self, prefix: str) -> float:
        """Return the minutes from the last ball whose keys begin with `prefix` to the end of the night.

        The times are those of the preflight.
        """
        done = [seconds for key, seconds in self._preflight_result.timeline.items() if key.startswith(f"{prefix}/")]
        return (self._preflight_result.machine_seconds - max(done, default=0.0)) / S_PER_MIN

    @property
    def _left_minutes(self) -> float:
        passed = (self._clock.now() - self._began_s) / S_PER_MIN
        return self._slot.minutes - self._slot.reserve - passed

    def _measure(
        self, prefix: str, positions: Sequence[Position], before: MeasuredPositions | None = None
    ) -> MeasuredPositions:
        mount_poses = None if before is None else before.mount_poses
        return measure(self._engine, self._plan, prefix, positions, self._job, self.rules, mount_poses)

    def _judged(self, measured: MeasuredPositions) -> Judgement:
        self.progress.measured = measured
        judgement = judge_measurement(self._judge, self._plan, self._job, measured, self._correction)
        self.progress.night = judgement.report
        return judgement

    # ------------------------------------------------------------------ out of limits

    def _out_of_limits(self, measured: MeasuredPositions, judgement: Judgement) -> None:
        """Calibrate in full if this is permitted and time is left.

        Otherwise diagnose the change and request a calibration.
        """
        full = job_at_station(self._judge.job, self._plan.station)
        if self._slot.full_allowed and self._minutes_of(full) <= self._left_minutes:
            report = replace(judgement.report, decision=Decision.FULL_DONE)
            calibrate_in_full(self, full, self._context, self._judge, report)
            return
        report = self._diagnosed(measured, judgement)
        self._tracker.enter(RunState.IDENTIFYING)
        self.progress.night = replace(report, decision=Decision.FULL_NEEDED)
        self._journal.decision("night", self.progress.night.as_json())
        record_full_calibration_need(self._journal, report.reason)
        raise refusal_until_full(report.reason)

    def _diagnosed(self, measured: MeasuredPositions, judgement: Judgement) -> NightReport:
        """Use the rest of the slot for positions that discriminate between the suspected errors; return the report."""
        done, report = positions_in(measured), judgement.report
        chosen = list(
            self._chooser.discriminating(
                self._judge.prior,
                judgement.found.suspects()[:SUSPECTS],
                minutes=self._left_minutes,
                measured=done,
            )
        )
        while chosen:
            if self._minutes_of(self._job, additional_positions(self._plan, DIAGNOSIS, chosen)) <= self._left_minutes:
                break
            chosen.pop()
        if not chosen:
            return report
        self._job = replace(self._job, positions=(*self._job.positions, *chosen))
        again = self._judged(join_measured(measured, self._measure(DIAGNOSIS, chosen, measured)))
        return again.report if not again.within else replace(again.report, reason=report.reason)

    def _minutes_of(self, job: Job, procedure: Procedure | None = None) -> float:
        """Return the machine minutes of a procedure, computed by a preflight.

        An abort request interrupts the preflight.
        """
        return run_preflight(job, procedure=procedure, watch=self._supervisor.check_stop_request).machine_minutes

    # ------------------------------------------------------------------ fusion

    def _fuse(self, measured: MeasuredPositions, report: NightReport) -> None:
        job, judge = self._job, self._judge
        balls = balls_for_estimate(job, measured)
        if len({ball.position for ball in balls}) < MIN_FUSED_POSITIONS:
            self._end(replace(report, reason="too little time was left to fuse anything"))
            return
        chosen = job.settings
        with translated(MeasurementFault):
            observations = observations_with_drift(job, balls, self._correction)
            options = fusion_options(chosen.temperature, observations, judge.prior)
            fit = fit_of_night(job, judge.reference, judge.nights, observations, options)
            options = replace(options, carried_over=fit.prior)
            order = chosen.identification.order
            with positions_named(balls):
                estimation = estimate_with_table(
                    job.machine, job.artefact, chosen.tool, observations, options, chosen.table, order
                )
        self._fit = fit
        report = with_fit(report, fit)
        self.progress.night = report
        self._store_estimate(estimation, balls)
        limits = self._rig.store.store_limits()
        self._pass_gates((*self._estimate_gates(estimation), *shape_gates(estimation.table, limits, job.gate_limits)))
        written = judge.reference.table.written
        now_um = judge.expected_ve_um(estimation.estimate, written)
        after_um = judge.expected_ve_um(estimation.estimate, estimation.estimate.parameters)
        report = replace(report, ve_now_um=now_um, ve_after_um=after_um)
        worthwhile = ExpectedGain(now_um, after_um).reaches(chosen.nightly.min_gain)
        last_part = FURTHER if self._plan.further else VERIFICATION
        if not worthwhile or self._planned_minutes_after(last_part) > self._left_minutes:
            record_accepted(self._journal, judge.reference.table)
            self._end(replace(report, decision=Decision.FUSED))
            return
        self.progress.night = report
        self._write_and_prove(estimation, measured)

    def _estimate_gates(self, estimation: EstimationResult) -> tuple[Gate, ...]:
        limits = self._job.gate_limits
        gates = estimate_gates(estimation.estimate, limits)
        prior = self._judge.prior if self._fit is None else self._fit.prior
        change = change_since(self._job, self._judge.reference, self._nights, estimation.estimate, prior)
        return (*gates, change_gate(change.found_um, change.expected_um, limits))

    def _proof(self, estimation: EstimationResult, measured: MeasuredPositions, after: Sequence[MeasuredBall]) -> Proof:
        proof = super()._proof(estimation, measured, after)
        report = self.progress.night
        assert report is not None  # noqa: S101  judged before anything was fused
        decision = Decision.WRITTEN if proof.accepted else Decision.RESTORED
        self.progress.night = replace(report, decision=decision, reason="" if proof.accepted else proof.reason)
        self._journal.decision("night", self.progress.night.as_json())
        return proof

    def _end(self, report: NightReport) -> None:
        self.progress.night = report
        self._journal.decision("night", report.as_json())
        self._tracker.enter(RunState.COMPLETE, report.reason or report.decision.value)
