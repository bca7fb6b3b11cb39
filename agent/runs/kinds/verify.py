"""Kind of run `verify`.

The fewest positions that find a step of a squareness of the stated size are measured with active compensation and
compared with the last accepted night. The run writes no compensation table.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

from agent.errors import GateRefused
from agent.execution.journal import RunJournal
from agent.execution.states import RunState
from agent.execution.steps import Conclude, Enter, Fork, Plan, RunPlan
from agent.planning.job import Job
from agent.probing.measured_balls import Correction, MeasuredBall
from agent.probing.publish import ActiveCompensation
from agent.probing.run_plan import MEASURED, MeasuredPositions, measure_positions, note_measured
from agent.results.run_outcome import NightReport
from agent.runs.kinds.calibrate import nights_since
from agent.runs.kinds.drift_check import Judge, Judgement
from agent.runs.kinds.night_plan import VERIFICATION, NightPlan, job_at_station, station_of
from agent.runs.kinds.position_choice import PositionChooser
from agent.runs.kinds.run_parts import PreparedRun, complete, found_compensation, prepared_run, refused
from agent.runs.kinds.verification_choice import VerificationChoice, VerificationChooser
from agent.runs.planned_run import PlannedRun, StartConditions, plan_run
from agent.runs.reference_state import ReferenceState, require_reference
from twin.monitoring.step_power import SmallestStep

ITS_TABLE, OTHER_TABLE = "accepted table active", "another table active"
_LITTLE = 0.1
"""Share by which the smallest step found may exceed the planned one without a warning."""


@dataclass(frozen=True)
class Verification:
    """Kind of run that only verifies the machine.

    `station` is the station of the artefact; if it is None, the station is taken from the settings. `nights` is the
    number of nights since the last accepted night; if it is None, the number is computed from the date.
    """

    station: int | None = None
    nights: float | None = None
    name: str = "verify"

    def plan(self, job: Job, start: StartConditions, watch: Callable[[], None]) -> PlannedRun:
        station = station_of(job, self.station)
        reference = require_reference(job, start.run)
        judge = Judge(job, reference, nights_since(reference, self.nights, start.at))
        chooser = PositionChooser(job_at_station(job, station), station)
        choice = VerificationChooser.of(chooser, judge.prior).choice()
        own = choice.plan.job(job)
        return plan_run(own, self, start, lambda: verification(own, choice, judge), watch)


def verification(job: Job, choice: VerificationChoice, judge: Judge) -> RunPlan:
    """Return the plan that measures a few positions and compares them with their prediction from the last accepted
    night. It does not change the compensation."""
    return (yield from with_table_of(judge.reference, lambda found: _verified(job, choice, judge, found)))


def _verified(job: Job, choice: VerificationChoice, judge: Judge, found: ActiveCompensation) -> RunPlan:
    ready, measured = yield from check_measurement(job, choice.plan, found)
    yield from note_measured(MEASURED, measured)
    yield Enter("state/identifying", RunState.IDENTIFYING)

    def record(journal: RunJournal, made: NightReport) -> None:
        journal.decision("verify", made.as_json())

    report = yield Conclude(
        "verify/report",
        lambda: verified_report(judge, choice, job.balls_of(measured, held_out=False), ready.correction),
        None,
        record,
    )
    yield from complete(lambda: report.reason or report.decision.value)
    return None


def verified_report(
    judge: Judge, choice: VerificationChoice, balls: Sequence[MeasuredBall], correction: Correction
) -> NightReport:
    """Compare the measured `balls` of a verification with the prediction from the last accepted night. No estimate uses
    them, so all of them are held out. The smallest step that the verification finds is that of the balls which were
    measured; the report warns if it is clearly larger than planned."""
    judgement = judge.judge_balls(choice.station, balls, balls, correction, choice.evidence)
    planned, finds = choice.worst_squareness, choice.worst_found(judgement.power)
    return replace(judgement.report, finds=finds, warning=_shortfall(planned, finds))


def _shortfall(planned: SmallestStep | None, finds: SmallestStep | None) -> str:
    """Return in words how much less than planned a verification finds, for example because balls were left out; empty
    if it is little."""
    if planned is None or planned.size is None or finds is None:
        return ""
    if finds.size is not None and finds.size <= (1.0 + _LITTLE) * planned.size:
        return ""
    return f"less is found than planned: smallest squareness step {finds.text}, planned {planned.text}"


def with_table_of(reference: ReferenceState, then: Callable[[ActiveCompensation], RunPlan]) -> RunPlan:
    """Read the active compensation, and continue with the plan that `then` returns if it is the last accepted table.
    Otherwise end the run with a refusal.
    """
    found = yield from found_compensation()
    return Fork(
        "before/table",
        lambda: ITS_TABLE if reference.is_table(found.table) else OTHER_TABLE,
        {ITS_TABLE: lambda: then(found), OTHER_TABLE: lambda: refused(lambda: _refuse_other(reference, found))},
        expected=ITS_TABLE,
    )


def _refuse_other(reference: ReferenceState, found: ActiveCompensation) -> None:
    raise GateRefused(
        f"bank {found.bank} is active, and it does not hold the table accepted in run {reference.run_id}",
        hint="activate that table again, or run `volcal calibrate`",
    )


def check_measurement(
    job: Job, plan: NightPlan, found: ActiveCompensation
) -> Plan[tuple[PreparedRun, MeasuredPositions]]:
    """Prepare the probe and measure the positions of the check at the beginning of a night."""
    ready = yield from prepared_run(job, found)
    order = plan.order(VERIFICATION, plan.first)
    measured = yield from measure_positions(order, job.layout, ready.rules)
    return ready, measured


def judge_measurement(
    judge: Judge, plan: NightPlan, job: Job, measured: MeasuredPositions, correction: Correction
) -> Judgement:
    """Compare all balls measured in a night, including those of held-out positions, with the prediction from the last
    accepted night, the reference of `judge`."""
    held_out = job.balls_of(measured, held_out=True)
    every = [*held_out, *job.balls_of(measured, held_out=False)]
    return judge.judge_balls(plan.station, every, held_out, correction, job.settings.nightly.step_evidence)
