"""Kind of run `nightly`.

The run verifies the machine and measures the positions that reduce the uncertainty most. It then combines the result
with the estimate of earlier nights. A machine that is out of limits is calibrated in full if the slot permits it;
otherwise the change is diagnosed, and a full calibration is requested.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

from agent.errors import MeasurementFault
from agent.execution.journal import RunJournal
from agent.execution.states import RunState
from agent.execution.steps import Conclude, Enter, Fork, Plan, Point, ProvePlan, RunPlan, known
from agent.files import translated
from agent.planning.job import Job
from agent.planning.preflight import PreflightResult, run_preflight
from agent.probing.measured_balls import observations_of
from agent.probing.publish import ActiveCompensation
from agent.probing.repeated_positions import join_measured
from agent.probing.run_plan import MEASURED, MeasuredPositions, measure_positions, note_measured, positions_in
from agent.results.estimation import EstimationResult, estimate_in_run
from agent.results.gates.estimate_gates import change_gate, estimate_gates
from agent.results.gates.gate import Gate
from agent.results.gates.table_gates import proof_gate, shape_gates
from agent.results.observations import balls_for_estimate
from agent.results.run_outcome import Decision, NightReport, Proof, no_gain_text
from agent.results.table_replacement import ExpectedGain
from agent.runs.change_since_reference import change_since, fit_of_night
from agent.runs.consent import Consent
from agent.runs.kinds.calibrate import nights_since
from agent.runs.kinds.calibration import (
    REFUSE,
    WRITE,
    CalibrationTask,
    checked_gates,
    estimated,
    gates_refused,
    power_of_proof,
    way_through,
    written,
)
from agent.runs.kinds.drift_check import Judge, Judgement, with_fit
from agent.runs.kinds.full_calibration import (
    PendingCalibration,
    calibrated_in_full,
    record_night,
    refuse_until_full,
)
from agent.runs.kinds.night_plan import (
    FURTHER,
    MIN_FUSED_POSITIONS,
    VERIFICATION,
    NightPlan,
    job_at_station,
    night_plan,
    station_of,
)
from agent.runs.kinds.position_choice import PositionChooser
from agent.runs.kinds.run_parts import PreparedRun, complete, refused
from agent.runs.kinds.slot import RunningSlot, Slot, begin_slot, too_late
from agent.runs.kinds.verify import check_measurement, judge_measurement, with_table_of
from agent.runs.planned_run import PlannedRun, StartConditions
from agent.runs.reference_state import (
    full_calibration_need,
    record_accepted,
    record_full_calibration_need,
    require_reference,
)
from agent.thermal.machine_drift import run_drift, thermal_options
from drivers.roles import StoreLimits
from twin.artefact.position_set import Position
from twin.monitoring.night_fit import NightFit

DIAGNOSIS = "diagnosis"
SUSPECTS = 8
"""Largest number of suspected errors between which a diagnosis discriminates."""

ALL_FURTHER, FEWER, NO_FURTHER, OUT = "all further positions", "fewer further positions", "check only", "out of limits"
WITHIN = "within limits"
FULL, DIAGNOSE = "full calibration", "diagnosis"
FUSE_KEPT, TOO_FEW = "fused, table kept", "too few positions"


@dataclass(frozen=True)
class Night:
    """Kind of run that verifies the machine and improves the estimate.

    `slot_minutes` is the length of the slot. `full_allowed` is True if, in this night, a person moves the artefact
    between stations and consents to a table for a changed machine. If `slot_minutes` or `full_allowed` is None, it is
    taken from the settings. `station` is the station of the artefact; if it is None, the station is taken from the
    settings. `nights` is the number of nights since the last accepted night; if it is None, the number is computed from
    the date.
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
            chosen.reserve_minutes,
            chosen.full_allowed if self.full_allowed is None else self.full_allowed,
        )
        pending = full_calibration_need(job.settings.state_directory, start.run)
        if pending is not None:
            return PendingCalibration(self, here, station, judge, slot, pending).plan(start, watch)
        chooser = PositionChooser(here, station)

        def planner(plan: NightPlan) -> Callable[[Job], RunPlan]:
            return lambda own: night(NightTask(own, judge, plan, chooser, slot, start.store), _no_timetable)

        plan, preflight = night_plan(chooser, judge, slot.minutes, start.start_mm, watch, planner)
        own = plan.job(job)
        task = NightTask(own, judge, plan, chooser, slot, start.store)
        return PlannedRun(
            own, self, start, preflight, lambda: night(task, lambda: preflight), partial(too_late, slot, preflight)
        )


def _no_timetable() -> PreflightResult:
    raise AssertionError("the timetable of a night is known only after its preflight")


@dataclass(frozen=True, eq=False)
class NightTask:
    """Task of a night: the job with the positions of the night, the judge of the machine, the positions in their order,
    the choice of positions for a diagnosis, the slot, and the limits of the compensation store."""

    job: Job
    judge: Judge
    plan: NightPlan
    chooser: PositionChooser
    slot: Slot
    store: StoreLimits


@dataclass(frozen=True, eq=False)
class _Night:
    """Night in progress: its task, the prepared probe, and the slot that has begun."""

    task: NightTask
    ready: PreparedRun
    slot: RunningSlot

    @property
    def job(self) -> Job:
        return self.task.job

    def measure(self, prefix: str, positions: Sequence[Position], before: MeasuredPositions) -> Plan[MeasuredPositions]:
        """Measure `positions` after those in `before`, and return both together."""
        order = self.task.plan.order(prefix, positions)
        more = yield from measure_positions(
            order, self.job.layout, self.ready.rules, before.mount_poses, before.last_conditions
        )
        return join_measured(before, more)

    def judged(self, key: str, measured: MeasuredPositions) -> Plan[Judgement]:
        """Compare what was measured with the last accepted night."""
        yield from note_measured(MEASURED, measured)
        task = self.task
        judgement: Judgement = yield Conclude(
            key, lambda: judge_measurement(task.judge, task.plan, task.job, measured, self.ready.correction)
        )
        yield Conclude(f"{key}/report", lambda: judgement.report)
        return judgement


def night(task: NightTask, timetable: Callable[[], PreflightResult]) -> RunPlan:
    """Return the plan of a night. `timetable` returns its preflight; it is called on the machine only."""
    slot = yield from begin_slot(task.slot, timetable)
    return (yield from with_table_of(task.judge.reference, lambda found: _checked(task, slot, found)))


def _checked(task: NightTask, slot: RunningSlot, found: ActiveCompensation) -> RunPlan:
    ready, measured = yield from check_measurement(task.job, task.plan, found)
    running = _Night(task, ready, slot)
    judgement = yield from running.judged("night/check", measured)
    left = yield from slot.left_minutes("night/checked")
    further = task.plan.further
    counts = {ALL_FURTHER: len(further), FEWER: len(further) - 1, NO_FURTHER: 0}
    ways: dict[str, Callable[[], RunPlan]] = {
        name: partial(_further, running, measured, count, left) for name, count in counts.items() if count > 0
    }
    ways[NO_FURTHER] = lambda: _fused(running, measured, lambda: judgement)
    ways[OUT] = lambda: _out_of_limits(running, measured, lambda: judgement)

    def choose() -> str:
        if not judgement.within:
            return OUT
        fitting = _fitting(running, left)
        return ALL_FURTHER if fitting == len(further) > 0 else FEWER if fitting else NO_FURTHER

    return Fork("night/way", choose, ways, expected=ALL_FURTHER if further else NO_FURTHER)


def _fitting(running: _Night, left_minutes: float) -> int:
    """Return the number of further positions for which time is left after reserving the time of the proof."""
    further = list(running.task.plan.further)
    needed = running.slot.needed_after(VERIFICATION)
    while further and needed > left_minutes:
        needed -= running.task.chooser.minutes([further.pop()])
    return len(further)


def _further(running: _Night, measured: MeasuredPositions, count: int, left: float) -> RunPlan:
    """Use the rest of the slot for further positions. If not all of them fit, their number is decided on the machine,
    and the shorter plan is proved before it begins."""
    further = running.task.plan.further
    if count < len(further):
        count = yield Conclude("night/fitting", lambda: _fitting(running, left), count)
        yield ProvePlan(
            "night/fewer",
            partial(_minutes_of, running.job, partial(_only, running, measured, FURTHER, further[:count])),
        )
    measured = yield from running.measure(FURTHER, further[:count], measured)
    judgement = yield from running.judged("night/further", measured)
    return Fork(
        "night/after-further",
        lambda: WITHIN if judgement.within else OUT,
        {
            WITHIN: lambda: _fused(running, measured, lambda: judgement),
            OUT: lambda: _out_of_limits(running, measured, lambda: judgement),
        },
        expected=WITHIN,
    )


def _only(running: _Night, measured: MeasuredPositions, prefix: str, positions: Sequence[Position], _: Job) -> RunPlan:
    """Return the plan that measures only `positions`, which were chosen during the night, for a preflight.

    The readings of the thermometers are left out: the machine of the preflight has its own temperature and clock.
    """
    order = running.task.plan.order(prefix, positions)
    yield from measure_positions(order, running.job.layout, running.ready.rules, measured.mount_poses)
    return None


def _minutes_of(job: Job, plan_of: Callable[[Job], RunPlan], at_mm: Point, watch: Callable[[], None]) -> float:
    """Return the machine minutes of a plan from the axis positions `at_mm`, computed by a preflight."""
    return run_preflight(job, plan_of, at_mm, watch, every_branch=False).machine_minutes


# ---------------------------------------------------------------------- out of limits


def _out_of_limits(running: _Night, measured: MeasuredPositions, judgement: Callable[[], Judgement]) -> RunPlan:
    """Calibrate in full if this is permitted and time is left.

    Otherwise diagnose the change and request a calibration.
    """
    task = running.task
    ways: dict[str, Callable[[], RunPlan]] = {DIAGNOSE: lambda: _diagnosed(running, measured, judgement)}
    if not task.slot.full_allowed:
        return (yield from ways[DIAGNOSE]())
    full = job_at_station(task.judge.job, task.plan.station)

    def in_full() -> RunPlan:
        def report() -> NightReport:
            return replace(judgement().report, decision=Decision.FULL_DONE)

        return calibrated_in_full(full, running.ready, task.store, task.judge, task.plan.station, report)

    needed = yield ProvePlan("night/full-minutes", partial(_minutes_of, full, lambda _: in_full()))
    left = yield from running.slot.left_minutes("night/full-left")
    ways[FULL] = in_full
    return Fork("night/out", lambda: FULL if needed <= left else DIAGNOSE, ways, expected=DIAGNOSE)


def _diagnosed(running: _Night, measured: MeasuredPositions, judgement: Callable[[], Judgement]) -> RunPlan:
    """Use the rest of the slot for positions that discriminate between the suspected errors; request a full
    calibration."""
    task = running.task
    report: Callable[[], NightReport] = lambda: judgement().report  # noqa: E731  replaced by a second look
    left = yield from running.slot.left_minutes("night/diagnosis-left")
    chosen: tuple[Position, ...] = yield Conclude(
        "night/diagnosis-choice",
        lambda: task.chooser.discriminating(
            task.judge.prior, judgement().found.suspects()[:SUSPECTS], minutes=left, measured=positions_in(measured)
        ),
        (),
    )
    while chosen:
        proved = partial(_minutes_of, running.job, partial(_only, running, measured, DIAGNOSIS, chosen))
        needed = yield ProvePlan(f"night/diagnosis-{len(chosen)}", proved)
        if needed <= left:
            break
        chosen = chosen[:-1]
    if chosen:
        own = replace(running.job, positions=(*running.job.positions, *chosen))
        running = replace(running, task=replace(task, job=own))
        yield known("night/job", own)
        measured = yield from running.measure(DIAGNOSIS, chosen, measured)
        again = yield from running.judged("night/diagnosis", measured)
        report = partial(_again, lambda: again, judgement)
    yield Enter("state/identifying", RunState.IDENTIFYING)

    def record(journal: RunJournal, made: NightReport) -> None:
        record_night(journal, made)
        record_full_calibration_need(journal, made.reason)

    needs = yield Conclude("night/report", lambda: replace(report(), decision=Decision.FULL_NEEDED), None, record)
    return (yield from refused(lambda: refuse_until_full(needs.reason)))


def _again(again: Callable[[], Judgement], first: Callable[[], Judgement]) -> NightReport:
    """Return the report after a diagnosis. The reason of the first look stays if the second finds nothing."""
    report = again().report
    return replace(report, reason=first().report.reason) if again().within else report


# ---------------------------------------------------------------------- fusion


@dataclass(frozen=True, eq=False)
class _Fused:
    """Estimate of a night, fused with that of the nights before, with the comparison between the two."""

    estimation: EstimationResult
    fit: NightFit


def _fused(running: _Night, measured: MeasuredPositions, judgement: Callable[[], Judgement]) -> RunPlan:
    yield Enter("state/identifying", RunState.IDENTIFYING)
    return Fork(
        "night/fusion",
        lambda: TOO_FEW if _positions(running.job, measured) < MIN_FUSED_POSITIONS else WITHIN,
        {
            WITHIN: lambda: _estimated(running, measured, judgement),
            TOO_FEW: lambda: _ended(
                lambda: replace(judgement().report, reason="too little time was left to fuse anything")
            ),
        },
        expected=WITHIN,
    )


def _positions(job: Job, measured: MeasuredPositions) -> int:
    return len({ball.position for ball in balls_for_estimate(job, measured)})


def _estimated(running: _Night, measured: MeasuredPositions, judgement: Callable[[], Judgement]) -> RunPlan:
    task, job = running.task, running.job
    fused = yield Conclude("night/fused", lambda: _fuse(running, measured))
    estimation = yield from estimated(job, lambda: fused.estimation, lambda: balls_for_estimate(job, measured))
    report = yield Conclude("night/fit", lambda: with_fit(judgement().report, fused.fit))
    gates = yield Conclude("night/gates", lambda: _gates(running, fused))
    expected = yield Conclude("night/expected", lambda: _expected(task.judge, estimation, report))
    last_part = FURTHER if task.plan.further else VERIFICATION
    left = yield from running.slot.left_minutes("night/proof-left")
    power = yield Conclude("night/power", lambda: _power(running, estimation, measured, expected))

    def choose() -> str:
        if way_through(gates, Consent.REFUSED) == REFUSE:
            return REFUSE
        provable = power is not None and proof_gate(power).passed
        return WRITE if provable and running.slot.needed_after(last_part) <= left else FUSE_KEPT

    return Fork(
        "night/choice",
        choose,
        {
            WRITE: lambda: _written(running, estimation, measured, lambda: gates, lambda: expected),
            FUSE_KEPT: lambda: _kept(running, lambda: gates, lambda: _with_power(expected, power)),
            REFUSE: lambda: gates_refused(lambda: gates),
        },
        expected=WRITE,
    )


def _fuse(running: _Night, measured: MeasuredPositions) -> _Fused:
    job, judge, chosen = running.job, running.task.judge, running.job.settings
    balls = balls_for_estimate(job, measured)
    with translated(MeasurementFault):
        drift = run_drift(chosen.temperature, [ball.conditions for ball in balls])
        observations = observations_of(balls, job.tool_offset_mm, running.ready.correction, drift)
        options = replace(thermal_options(chosen.temperature, drift), carried_over=judge.prior)
        fit = fit_of_night(job, judge.reference, judge.nights, observations, options)
        options = replace(options, carried_over=fit.prior)
        found = estimate_in_run(job, balls, observations, options)
    return _Fused(found.applied_by(running.task.store, job.tool_offset_mm), fit)


def _gates(running: _Night, fused: _Fused) -> tuple[Gate, ...]:
    job, judge, estimate = running.job, running.task.judge, fused.estimation.estimate
    limits = job.gate_limits
    change = change_since(job, judge.reference, judge.nights, estimate, fused.fit.prior)
    return (
        *estimate_gates(estimate, limits),
        change_gate(change.found_um, change.expected_um, limits),
        *shape_gates(fused.estimation.table, running.task.store, limits),
    )


def _expected(judge: Judge, estimation: EstimationResult, report: NightReport) -> NightReport:
    """Return `report` with the volumetric errors that are expected now and with a new table."""
    estimate = estimation.estimate
    now_um = judge.expected_ve_um(estimate, judge.reference.table.written)
    after_um = judge.expected_ve_um(estimate, estimate.parameters)
    return replace(report, ve_now_um=now_um, ve_after_um=after_um)


def _power(
    running: _Night, estimation: EstimationResult, measured: MeasuredPositions, expected: NightReport
) -> float | None:
    """Return the probability that the proof accepts a new table that works; None if such a table is not expected to be
    better by the margin of a night."""
    gain = ExpectedGain(expected.ve_now_um or 0.0, expected.ve_after_um or 0.0)
    if not gain.reaches(running.job.settings.nightly.min_gain):
        return None
    return power_of_proof(running.job, running.ready, running.task.store, estimation, measured)


def _with_power(report: NightReport, power: float | None) -> NightReport:
    """Return `report` with the reason why the active table is kept, if the proof of a new one could not show a gain."""
    if power is None or proof_gate(power).passed:
        return report
    return replace(report, reason=no_gain_text(power))


def _kept(running: _Night, gates: Callable[[], Sequence[Gate]], report: Callable[[], NightReport]) -> RunPlan:
    """Accept the fused estimate; the active table stays."""
    yield from checked_gates(gates)
    table = running.task.judge.reference.table
    yield known("night/kept", None, lambda journal, _: record_accepted(journal, table))
    return (yield from _ended(lambda: replace(report(), decision=Decision.FUSED)))


def _written(
    running: _Night,
    estimation: EstimationResult,
    measured: MeasuredPositions,
    gates: Callable[[], Sequence[Gate]],
    report: Callable[[], NightReport],
) -> RunPlan:
    yield from checked_gates(gates)
    task = running.task
    calibration = CalibrationTask(task.job, task.store, task.judge.reference, task.judge.nights, Consent.REFUSED)

    def reported(proof: Callable[[], Proof]) -> Plan[None]:
        yield Conclude("night/proved", lambda: _decided(report(), proof()), None, record_night)

    return (yield from written(calibration, running.ready, estimation, measured, reported))


def _decided(report: NightReport, proof: Proof) -> NightReport:
    decision = Decision.WRITTEN if proof.accepted else Decision.RESTORED
    return replace(report, decision=decision, reason="" if proof.accepted else proof.reason)


def _ended(report: Callable[[], NightReport]) -> RunPlan:
    ended = yield Conclude("night/ended", report, None, record_night)
    yield from complete(lambda: ended.reason or ended.decision.value)
    return None
