"""Plan of a calibration: the position set is measured, the errors are estimated, and a new table is written and proved.

The active table is confirmed instead if a new one would not be better by the stated margin. A new table that fails its
proof is replaced by the former one. Nightly runs use the parts of this plan from `calibrated` and `written` on.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

from agent.errors import GateRefused, MeasurementFault
from agent.execution.journal import RunJournal
from agent.execution.states import RunState
from agent.execution.steps import AskOperator, Conclude, Enter, Fork, Plan, RunPlan, known
from agent.files import translated
from agent.planning.job import Job
from agent.planning.stand_ins import STAND_IN_TABLE, USUAL_STORE
from agent.probing import publish
from agent.probing.measured_balls import MeasuredBall
from agent.probing.repeated_positions import measure_with_repeats
from agent.probing.run_plan import MEASURED, VERIFIED, MeasuredPositions, measure_positions, note_measured
from agent.results.decision_kinds import CONFIRMED
from agent.results.estimation import (
    EstimationResult,
    estimate_from_balls,
    estimate_text,
    provenance,
)
from agent.results.gates.estimate_gates import change_gate, estimate_gates
from agent.results.gates.gate import Gate
from agent.results.gates.gate_rules import CHANGE
from agent.results.gates.required_gates import names_of_failed, require_passed, with_consent
from agent.results.gates.table_gates import gain_gate, proof_gate, table_gates
from agent.results.journal_entries import record_held_out, record_identified
from agent.results.observations import balls_for_estimate
from agent.results.run_outcome import Confirmation, Decision, Proof
from agent.results.table_image import image_of, table_as_applied
from agent.results.table_replacement import (
    ExpectedGain,
    FormerBalls,
    confirm,
    expected_gain,
    proof_power,
    prove,
    written_parameters,
)
from agent.runs.change_since_reference import change_since
from agent.runs.consent import Consent, consent_request, opens_by_consent
from agent.runs.kinds.run_parts import (
    PreparedRun,
    complete,
    found_compensation,
    prepared_run,
    record_table,
    refused,
    restored,
)
from agent.runs.reference_state import AcceptedTable, ReferenceState, record_accepted
from agent.runs.run_results import BankInUse, CheckedGates
from drivers.errors import NotActiveYet
from drivers.roles import StoreLimits, TableImage

WRITE, ASK, KEEP, REFUSE = "table written", "consent asked", "table confirmed", "refused"
ACCEPT, RESTORE = "accepted", "former table restored"


@dataclass(frozen=True, eq=False)
class CalibrationTask:
    """Task of a calibration: the job, and the limits and the reference by which its result is judged.

    `store` contains the limits of the controller's compensation store. `reference` is the last accepted night of this
    machine, against which the change of the machine is judged; it is None if there is none. `nights` is the number of
    nights since then. `changed` is True if an earlier measurement has shown that the machine has changed. The active
    table is then replaced, never confirmed.
    """

    job: Job
    store: StoreLimits = USUAL_STORE
    reference: ReferenceState | None = None
    nights: float = 0.0
    consent: Consent = Consent.ASK
    changed: bool = False


def calibration(task: CalibrationTask) -> RunPlan:
    """Return the plan of a whole calibration."""
    found = yield from found_compensation()
    ready = yield from prepared_run(task.job, found)
    return (yield from calibrated(task, ready))


def nothing_more(_: Callable[[], Proof]) -> Plan[None]:
    """Return a plan without steps, to be carried out once the proof of a table is known."""
    yield from ()


AfterProof = Callable[[Callable[[], Proof]], Plan[None]]
"""Function that returns a plan that is carried out once the proof of a table is known, before it decides."""


def calibrated(
    task: CalibrationTask,
    ready: PreparedRun,
    standing_at: int | None = None,
    after_proof: AfterProof = nothing_more,
) -> RunPlan:
    """Return the plan that measures the position set, and writes and proves a table. `standing_at` is the station of
    the artefact, if it is not the one of the preparation."""
    job, prepared = task.job, ready.prepared
    station = prepared.standing_at if standing_at is None else standing_at
    order = replace(job.measuring_order, standing_at=station, placed=prepared.placed)
    return (
        yield from measure_with_repeats(
            order,
            job.layout,
            ready.rules,
            job.repeat_rules,
            lambda measured: concluded(task, ready, measured, after_proof),
        )
    )


@dataclass(frozen=True, eq=False)
class _Weighed:
    """Estimate of the machine, weighed against the active table: the expected gain of a new one, the power of its
    proof, the gates, and the way on. The power is None if no table would be written anyway."""

    gain: ExpectedGain
    power: float | None
    gates: tuple[Gate, ...]
    way: str


def concluded(
    task: CalibrationTask, ready: PreparedRun, measured: MeasuredPositions, after_proof: AfterProof
) -> RunPlan:
    """Return the plan that follows the last measurement: the errors are estimated, and a table is written and proved,
    or the active one is confirmed."""
    job = task.job
    yield from note_measured(MEASURED, measured)
    yield Enter("state/identifying", RunState.IDENTIFYING)
    estimation = yield from estimated(
        job, lambda: _estimate(task, ready, measured), lambda: balls_for_estimate(job, measured)
    )
    weighed = yield Conclude("identify/weighed", lambda: _weigh(task, ready, estimation, measured))

    def passed() -> RunPlan:
        yield from checked_gates(lambda: weighed.gates)
        return (yield from written(task, ready, estimation, measured, after_proof))

    return Fork(
        "identify/choice",
        lambda: str(weighed.way),
        {
            WRITE: passed,
            ASK: lambda: _asked(lambda: weighed.gates, passed),
            KEEP: lambda: _kept(task, ready, estimation, measured, lambda: weighed),
            REFUSE: lambda: gates_refused(lambda: weighed.gates),
        },
        expected=WRITE,
    )


def _estimate(task: CalibrationTask, ready: PreparedRun, measured: MeasuredPositions) -> EstimationResult:
    job = task.job
    with translated(MeasurementFault):
        found = estimate_from_balls(job, balls_for_estimate(job, measured), ready.correction)
    return found.applied_by(task.store, job.tool_offset_mm)


def estimated(
    job: Job, estimate: Callable[[], EstimationResult], balls: Callable[[], Sequence[MeasuredBall]]
) -> Plan[EstimationResult]:
    """Make and journal the estimate that `estimate` returns; `balls` returns the balls from which it is made."""

    def record(journal: RunJournal, estimation: EstimationResult) -> None:
        record_identified(journal, balls(), estimation)
        journal.estimate(estimate_text(estimation, provenance(job, journal.run_id)))

    estimation: EstimationResult = yield Conclude("identify/estimate", estimate, None, record)
    return estimation


def _weigh(
    task: CalibrationTask, ready: PreparedRun, estimation: EstimationResult, measured: MeasuredPositions
) -> _Weighed:
    """Weigh a new table against the active one. The active one is confirmed unless the gain reaches the stated margin
    and the proof can show the effect of the new one. On a machine that has changed it is never confirmed: the run is
    refused if the effect of a new one could not be shown."""
    job = task.job
    stored = table_as_applied(estimation.table, task.store)
    gain = expected_gain(estimation.estimate, estimation.unknown_um, ready.correction, stored.at, job.tool_offset_mm)
    gates = estimate_gates(estimation.estimate, job.gate_limits)
    if task.reference is not None:
        change = change_since(job, task.reference, task.nights, estimation.estimate)
        gates = (*gates, change_gate(change.found_um, change.expected_um, job.gate_limits))
    changed = task.changed or CHANGE in names_of_failed(gates)
    worth = None if changed else gain_gate(gain, job.settings.verification.min_gain)
    if worth is not None and not worth.passed:
        return _Weighed(gain, None, gates, REFUSE if names_of_failed(gates) else KEEP)
    to_write = (*gates, *(() if worth is None else (worth,)))
    to_write = (*to_write, *table_gates(estimation.table, estimation.travel, task.store, job.gate_limits))
    way = way_through(to_write, task.consent)
    if way == REFUSE:
        return _Weighed(gain, None, to_write, REFUSE)
    proof = proof_gate(power_of_proof(job, ready, task.store, estimation, measured))
    if proof.passed:
        return _Weighed(gain, proof.value, (*to_write, proof), way)
    if way == WRITE and not changed:
        return _Weighed(gain, proof.value, gates, KEEP)
    return _Weighed(gain, proof.value, (*to_write, proof), REFUSE)


def power_of_proof(
    job: Job, ready: PreparedRun, store: StoreLimits, estimation: EstimationResult, measured: MeasuredPositions
) -> float:
    """Return the probability that the proof accepts the table of the estimate if it works. Raises MeasurementFault if
    too few held-out balls were measured."""
    former = FormerBalls.of(job, estimation, measured, ready.correction)
    return proof_power(job, _as_stored(estimation, store), former)


def _as_stored(estimation: EstimationResult, store: StoreLimits) -> EstimationResult:
    """Return `estimation` with its table as the controller applies it. A proof compares what was measured with this
    table: the resolution of the controller is no mistake of the controller."""
    return replace(estimation, table=table_as_applied(estimation.table, store))


def way_through(gates: Sequence[Gate], consent: Consent) -> str:
    """Return the way on from `gates`: the table is written, the operator is asked for consent to a changed machine if
    nothing else is in the way, or the run is refused."""
    closed = [gate for gate in gates if not gate.passed and not opens_by_consent(gate, consent)]
    if not closed:
        return WRITE
    return ASK if consent is Consent.ASK and [gate.name for gate in closed] == [CHANGE] else REFUSE


def checked_gates(gates: Callable[[], Sequence[Gate]]) -> Plan[None]:
    """Journal the gates that `gates` returns. Those that were closed were opened by consent."""
    yield Conclude("identify/gates", lambda: CheckedGates(tuple(with_consent(gates()))), None, _record_gates)


def gates_refused(gates: Callable[[], Sequence[Gate]]) -> RunPlan:
    """End the run, because gates are closed; all gates are journaled."""
    yield Conclude("identify/gates", lambda: CheckedGates(tuple(gates())), None, _record_gates)
    return (yield from refused(lambda: require_passed(gates())))


def _record_gates(journal: RunJournal, checked: CheckedGates) -> None:
    for gate in checked.gates:
        journal.decision("gate", vars(gate))


def _asked(gates: Callable[[], Sequence[Gate]], then: Callable[[], RunPlan]) -> RunPlan:
    """Ask the operator for consent to a changed machine, and continue with the plan that `then` returns."""
    yield Conclude("consent/gates", lambda: CheckedGates(tuple(gates())))
    request = yield Conclude("consent/question", lambda: consent_request(gates()), consent_request(()))
    yield AskOperator("consent/change", request)
    return (yield from then())


def _kept(
    task: CalibrationTask,
    ready: PreparedRun,
    estimation: EstimationResult,
    measured: MeasuredPositions,
    weighed: Callable[[], _Weighed],
) -> RunPlan:
    """Keep the active table, and accept the estimate as the reference of later runs. The run is refused if the held-out
    balls contradict the estimate."""
    job = task.job
    yield from checked_gates(lambda: weighed().gates)

    def confirmation() -> Confirmation:
        former = FormerBalls.of(job, estimation, measured, ready.correction)
        confirmed = confirm(job, estimation, weighed().gain, weighed().power, former)
        return replace(confirmed, without_table=ready.found.table is None)

    def record(journal: RunJournal, found: Confirmation) -> None:
        journal.decision(CONFIRMED, {**vars(found), "decision": Decision.CONFIRMED.value})
        if found.reason:
            raise GateRefused(
                f"the active compensation is not confirmed: {found.reason}",
                hint="nothing was written; measure again, and check artefact, mount and temperatures",
            )
        parameters = written_parameters(estimation.estimate.model, ready.correction, job.tool_offset_mm)
        record_accepted(journal, AcceptedTable.of(job, parameters, ready.found.table))

    confirmed = yield Conclude("confirm", confirmation, None, record)
    yield from complete(lambda: str(confirmed.text))
    return None


def written(
    task: CalibrationTask,
    ready: PreparedRun,
    estimation: EstimationResult,
    measured: MeasuredPositions,
    after_proof: AfterProof = nothing_more,
) -> RunPlan:
    """Stage and activate the table, and measure the held-out positions again.

    If they disagree with the prediction, the former bank is reactivated. `after_proof` returns a plan that is carried
    out once the proof is known, before it decides.
    """
    job, limits = task.job, task.store
    image = yield Conclude("publish/image", lambda: image_of(estimation.table, limits), STAND_IN_TABLE)
    yield Enter("state/staging", RunState.STAGING)
    bank = publish.choose_bank(limits.banks, ready.found.bank)
    yield from publish.stage_table(bank, image)
    yield from record_table("staged", bank, image)
    yield Enter("state/activating", RunState.ACTIVATING)
    yield known("publish/bank", BankInUse(bank))
    try:
        yield from publish.activate("activate", bank, limits.activation)
    except NotActiveYet as error:
        # Not a failure: the run is resumed once the controller has done its part.
        waiting = error
        yield known("publish/waits", waiting)
        yield Enter("state/written", RunState.WRITTEN, lambda: str(waiting))
        return None
    yield Enter("state/verifying", RunState.VERIFYING)
    order = job.verification_order(measured.standing_at, measured.placed)
    verified = yield from measure_positions(
        order, job.layout, ready.rules, measured.mount_poses, measured.last_conditions
    )
    yield from note_measured(VERIFIED, verified)

    def proof() -> Proof:
        former = FormerBalls.of(job, estimation, measured, ready.correction)
        return prove(job, _as_stored(estimation, limits), former, job.balls_of(verified, held_out=True))

    return (yield from _proved(task, ready, estimation, measured, verified, image, proof, after_proof))


def _proved(
    task: CalibrationTask,
    ready: PreparedRun,
    estimation: EstimationResult,
    measured: MeasuredPositions,
    verified: MeasuredPositions,
    image: TableImage,
    proof_of: Callable[[], Proof],
    after_proof: AfterProof,
) -> RunPlan:
    job = task.job

    def record(journal: RunJournal, found: Proof) -> None:
        journal.decision("proof", vars(found))
        before, after = (job.balls_of(part, held_out=True) for part in (measured, verified))
        record_held_out(journal, job, estimation.reference(job.artefact).artefact, before, after)

    proof = yield Conclude("prove/proof", proof_of, None, record)
    yield from after_proof(lambda: proof)
    return Fork(
        "prove/verdict",
        lambda: ACCEPT if proof.accepted else RESTORE,
        {
            ACCEPT: lambda: _accepted(job, estimation, image, lambda: proof),
            RESTORE: lambda: _restored(ready, task.store, lambda: proof),
        },
        expected=ACCEPT,
    )


def _accepted(job: Job, estimation: EstimationResult, image: TableImage, proof: Callable[[], Proof]) -> RunPlan:
    """Record the estimate and the table as the reference with which later runs compare the machine."""

    def record(journal: RunJournal, _: object) -> None:
        record_accepted(journal, AcceptedTable.of(job, estimation.estimate.parameters, image))

    yield known("prove/accepted", None, record)
    yield from complete(lambda: proof().reason)
    return None


def _restored(ready: PreparedRun, limits: StoreLimits, proof: Callable[[], Proof]) -> RunPlan:
    yield Enter("state/restoring", RunState.RESTORING, lambda: proof().reason)
    yield from restored(ready.found, limits.activation)
    yield from complete(lambda: f"restored: {proof().reason}")
    return None
