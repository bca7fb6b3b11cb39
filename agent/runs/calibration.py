"""Calibration run. It begins with the check that motion is permitted, and ends in one of three ways.

The active table is confirmed if a new one would not be better by the stated margin. Otherwise the new table is written
and proved; it is then accepted, or the former table is reactivated.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from agent.errors import GateRefused, MeasurementFault
from agent.execution.states import RunState
from agent.files import translated
from agent.planning.job import Job
from agent.probing import publish
from agent.probing.position import MeasuredBall
from agent.probing.repeated_positions import measure_with_repeats
from agent.probing.run_plan import MeasuredPositions, measure_positions
from agent.results.decision_kinds import CONFIRMED
from agent.results.estimation import (
    EstimationResult,
    estimate_from_balls,
    estimate_text,
    provenance,
    thermometer_facts,
)
from agent.results.gates import (
    CHANGE,
    Gate,
    change_gate,
    estimate_gates,
    gain_gate,
    require_passed,
    table_gates,
    with_consent,
)
from agent.results.journal_entries import record_held_out, record_identified
from agent.results.run_outcome import Decision, Proof
from agent.results.table_image import image_of
from agent.results.table_replacement import (
    ExpectedGain,
    FormerBalls,
    confirm,
    expected_gain,
    predicted_reduction,
    prove,
    written_parameters,
)
from agent.results.thermal_drift import balls_for_estimate
from agent.runs.change_since_reference import change_since
from agent.runs.consent import Consent, ask_consent, opens_by_consent
from agent.runs.guarded_run import GuardedRun
from agent.runs.reference_state import AcceptedTable, ReferenceState, record_accepted
from agent.runs.run_context import RunContext
from drivers.errors import NotActiveYet
from drivers.roles import TableImage
from twin.artefact.position_set import Position


class CalibrationRun(GuardedRun):
    """Run that calibrates the machine of a job (machine, artefact, settings and positions to measure).

    `reference` is the last accepted night of this machine (the last run whose estimate was accepted), against which the
    change of the machine is judged; it is None if there is no accepted night. `nights` is the number of nights since
    then. `changed` is True if an earlier measurement has shown that the machine has changed. The active table is then
    replaced, never confirmed.
    """

    def __init__(
        self,
        job: Job,
        context: RunContext,
        reference: ReferenceState | None = None,
        nights: float = 0.0,
        consent: Consent = Consent.ASK,
        *,
        changed: bool = False,
    ) -> None:
        super().__init__(job, context)
        self._changed = changed
        self._reference = reference
        self._nights = nights
        self._consent = consent

    def _work(self) -> None:
        self._begin()
        prepared = self._prepare_probe()
        self.calibrate(prepared.standing_at, prepared.placed)

    def calibrate(self, standing_at: int | None, placed: Position | None = None) -> None:
        """Measure all positions of the run's position set, estimate the machine's errors, write the new compensation
        table and prove it. `standing_at` is the station at which the artefact stands; it is None if the station is not
        known. `placed` is the position in which an artefact that is placed by hand stands.

        The state of the run must be MEASURING, and the active compensation must have been read before.
        """
        job, progress = self._job, self.progress
        order = replace(job.measuring_order, standing_at=standing_at, placed=placed)
        progress.measured = self._engine.run(measure_with_repeats(order, job.layout, self.rules, job.repeat_rules))
        self._tracker.enter(RunState.IDENTIFYING)
        balls = balls_for_estimate(job, progress.measured)
        with translated(MeasurementFault):
            estimation = estimate_from_balls(job, balls, self._correction)
        self._store_estimate(estimation, balls)
        new_um = estimation.volumetric.after_aligned.value_um
        gain = expected_gain(estimation.estimate, new_um, self._correction, job.tool_offset_mm)
        gates = self._estimate_gates(estimation)
        changed = self._changed or any(gate.name == CHANGE and not gate.passed for gate in gates)
        if not changed:
            worth = self._gain_gate(gain)
            if not worth.passed:
                self._pass_gates(gates)
                self._confirm(estimation, gain, progress.measured)
                return
            gates += (worth,)
        gates += table_gates(estimation.table, estimation.travel, self._rig.store.store_limits(), job.gate_limits)
        self._pass_gates(gates)
        self._write_and_prove(estimation, progress.measured)

    def _store_estimate(self, estimation: EstimationResult, balls: Sequence[MeasuredBall]) -> None:
        self.progress.estimation = estimation
        thermometer = thermometer_facts(estimation, self._job.settings.temperature)
        record_identified(self._journal, balls, estimation, thermometer)
        self._journal.estimate(estimate_text(estimation, provenance(self._job, self._journal.run_id)))

    def _gain_gate(self, gain: ExpectedGain) -> Gate:
        return gain_gate(gain, self._job.settings.verification.min_gain)

    def _estimate_gates(self, estimation: EstimationResult) -> tuple[Gate, ...]:
        gates = estimate_gates(estimation.estimate, self._job.gate_limits)
        if self._reference is None:
            return gates
        change = change_since(self._job, self._reference, self._nights, estimation.estimate)
        return (*gates, change_gate(change.found_um, change.expected_um, self._job.gate_limits))

    def _pass_gates(self, gates: Sequence[Gate]) -> None:
        """Journal every gate.

        Raise GateRefused if one does not pass. The gate `CHANGE` also passes if consent is given.
        """
        self.progress.gates += gates
        given = any(opens_by_consent(gate, self._consent) for gate in gates)
        if given or (self._consent is Consent.ASK and self._engine.run(ask_consent(gates))):
            self.progress.gates = with_consent(self.progress.gates)
        for gate in self.progress.gates:
            self._journal.decision("gate", vars(gate))
        require_passed(self.progress.gates)

    def _confirm(self, estimation: EstimationResult, gain: ExpectedGain, measured: MeasuredPositions) -> None:
        """Keep the active table, and accept the estimate as the reference of later runs. Raises GateRefused if the
        held-out balls contradict the estimate."""
        job, found = self._job, self.progress.found
        assert found is not None  # noqa: S101  read before anything is measured
        confirmed = confirm(job, estimation, gain, FormerBalls.of(job, estimation, measured, self._correction))
        self._journal.decision(CONFIRMED, {**vars(confirmed), "decision": Decision.CONFIRMED.value})
        if confirmed.reason:
            raise GateRefused(
                f"the active compensation is not confirmed: {confirmed.reason}",
                hint="nothing was written; measure again, and check artefact, mount and temperatures",
            )
        self.progress.confirmed = confirmed
        written = written_parameters(estimation.estimate.model, self._correction, job.tool_offset_mm)
        record_accepted(self._journal, AcceptedTable.of(job, written, found.table))
        self._tracker.enter(RunState.COMPLETE, confirmed.text)

    def _write_and_prove(self, estimation: EstimationResult, measured: MeasuredPositions) -> None:
        """Stage and activate the table, and measure the held-out positions again.

        If they disagree with the prediction, the former bank is reactivated.
        """
        progress, enter = self.progress, self._tracker.enter
        assert progress.found is not None  # noqa: S101  read before anything is measured
        image = image_of(estimation.table, self._rig.store.store_limits())
        former = FormerBalls.of(self._job, estimation, measured, self._correction)
        reduction = predicted_reduction(self._job, estimation, former)
        enter(RunState.STAGING, "" if reduction.can_be_shown else f"the proof cannot be significant: {reduction.text}")
        bank = publish.choose_bank(self._rig.store.store_limits().banks, progress.found.bank)
        self._engine.run(publish.stage_table(bank, image))
        self._journal.table("staged", bank, image)
        enter(RunState.ACTIVATING)
        progress.active_bank = bank
        try:
            self._engine.run(publish.activate("activate", bank, self.activation))
        except NotActiveYet as waiting:
            # Not a failure: the run is resumed once the controller has done its part.
            progress.error = waiting
            enter(RunState.WRITTEN, str(waiting))
            return
        enter(RunState.VERIFYING)
        self._verify(estimation, measured, image)

    def _verify(self, estimation: EstimationResult, measured: MeasuredPositions, image: TableImage) -> None:
        job, progress = self._job, self.progress
        order = job.verification_order(measured.standing_at, measured.placed)
        progress.verified = self._engine.run(measure_positions(order, job.layout, self.rules, measured.mount_poses))
        before, after = (job.balls_of(part, held_out=True) for part in (measured, progress.verified))
        progress.proof = self._proof(estimation, measured, after)
        self._journal.decision("proof", vars(progress.proof))
        record_held_out(self._journal, job, estimation.reference(job.artefact).artefact, before, after)
        if progress.proof.accepted:
            self._accept(estimation, image)
            self._tracker.enter(RunState.COMPLETE, progress.proof.reason)
            return
        self._tracker.enter(RunState.RESTORING, progress.proof.reason)
        self._restore(after_fault=False)
        self._tracker.enter(RunState.COMPLETE, f"restored: {progress.proof.reason}")

    def _proof(self, estimation: EstimationResult, measured: MeasuredPositions, after: Sequence[MeasuredBall]) -> Proof:
        return prove(self._job, estimation, FormerBalls.of(self._job, estimation, measured, self._correction), after)

    def _accept(self, estimation: EstimationResult, image: TableImage) -> None:
        """Record the estimate and the table as the reference with which later runs compare the machine."""
        record_accepted(self._journal, AcceptedTable.of(self._job, estimation.estimate.parameters, image))
