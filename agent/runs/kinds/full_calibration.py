"""Full calibration that an earlier night found necessary. Until a slot permits the calibration, all nightly runs only
verify the machine."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

from agent.errors import GateRefused, PlanRefused
from agent.execution.journal import RunJournal
from agent.execution.states import RunState
from agent.execution.steps import Conclude, Enter, Plan, RunPlan, known
from agent.planning.job import Job
from agent.probing.publish import ActiveCompensation
from agent.probing.run_plan import MEASURED, note_measured
from agent.results.run_outcome import Decision, NightReport, Proof
from agent.runs.consent import Consent
from agent.runs.kinds.calibration import CalibrationTask, calibrated
from agent.runs.kinds.drift_check import Judge
from agent.runs.kinds.position_choice import PositionChooser
from agent.runs.kinds.run_parts import PreparedRun, found_compensation, prepared_run, refused
from agent.runs.kinds.slot import Slot
from agent.runs.kinds.verification_choice import VerificationChoice, VerificationChooser
from agent.runs.kinds.verify import check_measurement, verified_report, with_table_of
from agent.runs.planned_run import Kind, PlannedRun, StartConditions, plan_run
from agent.runs.reference_state import FullCalibrationNeed
from drivers.roles import StoreLimits


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
        """Plan the full calibration. If the slot does not permit it or is too short for it, plan a verification
        instead.

        Raises PlanRefused if the slot is too short even for the verification.
        """
        return self._full(start, watch) or self._verification(start, watch)

    def _full(self, start: StartConditions, watch: Callable[[], None]) -> PlannedRun | None:
        if not self.slot.full_allowed:
            return None
        planned = plan_run(self.here, self.kind, start, lambda: pending_calibration(self, start.store), watch)
        return planned if self.slot.holds(planned.preflight.longest_minutes) else None

    def _verification(self, start: StartConditions, watch: Callable[[], None]) -> PlannedRun:
        slot, pending = self.slot, self.pending
        chooser = VerificationChooser.of(PositionChooser(self.here, self.station), self.judge.prior)
        planned = self._verified(chooser.choice(), start, watch)
        if not slot.holds(planned.preflight.machine_minutes):  # fewer positions are better than none
            planned = self._verified(chooser.usual(), start, watch)
        if not slot.holds(planned.preflight.machine_minutes):
            raise PlanRefused(
                f"the verification takes {planned.preflight.machine_minutes:.1f} min, "
                f"but the slot has {slot.minutes:g}",
                hint=f"a full calibration is needed since run {pending.run_id}: give a slot for it",
            )
        return planned

    def _verified(self, choice: VerificationChoice, start: StartConditions, watch: Callable[[], None]) -> PlannedRun:
        own, judge = choice.plan.job(self.here), self.judge

        def procedure() -> RunPlan:
            return with_table_of(judge.reference, lambda found: _verified_only(own, choice, judge, self.pending, found))

        return plan_run(own, self.kind, start, procedure, watch)


def pending_calibration(asked: PendingCalibration, store: StoreLimits) -> RunPlan:
    """Return the plan of the full calibration that an earlier night found necessary."""
    found = yield from found_compensation()
    ready = yield from prepared_run(asked.here, found)
    report = NightReport(
        Decision.FULL_DONE,
        since=asked.judge.reference.run_id,
        nights=asked.judge.nights,
        station=asked.station,
        positions=0,
        reason=asked.pending.reason,
        ve_before_um=asked.judge.before_um,
    )
    return (yield from calibrated_in_full(asked.here, ready, store, asked.judge, asked.station, lambda: report))


def calibrated_in_full(
    job: Job,
    ready: PreparedRun,
    store: StoreLimits,
    judge: Judge,
    station: int,
    report: Callable[[], NightReport],
) -> RunPlan:
    """Return the plan that continues a night as a full calibration of `job`. `ready` is the prepared run, `judge` the
    comparison with the last accepted night, and `report` returns the report of the night so far.

    The operator is not asked for consent to a table for the changed machine, because the permission for a full
    calibration includes this consent.
    """
    yield known("night/job", job)
    yield Conclude("night/full", report)
    task = CalibrationTask(job, store, judge.reference, judge.nights, Consent.GIVEN, changed=True)
    return (yield from calibrated(task, replace(ready, job=job), station, lambda proof: _note_restored(report, proof)))


def _note_restored(report: Callable[[], NightReport], proof: Callable[[], Proof]) -> Plan[None]:
    def reported() -> NightReport:
        found = proof()
        if found.accepted:
            return report()
        return replace(report(), decision=Decision.RESTORED, reason=found.reason)

    yield Conclude("night/proved", reported)


def _verified_only(
    job: Job, choice: VerificationChoice, judge: Judge, pending: FullCalibrationNeed, found: ActiveCompensation
) -> RunPlan:
    """Make a verification, because the required full calibration cannot be done in this slot."""
    ready, measured = yield from check_measurement(job, choice.plan, found)
    yield from note_measured(MEASURED, measured)
    yield Enter("state/identifying", RunState.IDENTIFYING)

    def report_of() -> NightReport:
        report = verified_report(judge, choice, job.balls_of(measured, held_out=False), ready.correction)
        return replace(report, decision=Decision.FULL_NEEDED, reason=pending.reason)

    yield Conclude("night/report", report_of, None, record_night)
    return (yield from refused(lambda: refuse_until_full(f"{pending.reason} (run {pending.run_id})")))


def record_night(journal: RunJournal, report: NightReport) -> None:
    """Journal the decision of a night."""
    journal.decision("night", report.as_json())


def refuse_until_full(reason: str) -> None:
    """Raise GateRefused, because a full calibration is needed."""
    raise GateRefused(
        f"a full calibration is needed: {reason}", hint="the next slot with --full-allowed that is long enough does it"
    )
