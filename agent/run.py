"""A calibration from permission to proof: measure, identify, gate, stage, activate, verify, accept or restore.

The compensation that was found is restored on every way out but the accepted one, and read back.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from agent.conduct import Conduct
from agent.execution.engine import Engine
from agent.execution.journal import RunJournal
from agent.execution.states import RunState
from agent.execution.supervisor import Supervisor
from agent.files import translated
from agent.findings import Finding, find_machine, prove, provenance
from agent.gates import Gate, estimate_gates, require, table_gates
from agent.job import Job
from agent.observing import no_correction
from agent.outcome import Proof
from agent.plans import publish
from agent.plans.measure import Measured, measure_positions
from agent.plans.preparation import Prepared
from agent.plans.recover import withdraw
from agent.rig import Rig
from agent.table_image import image_of, table_of
from drivers.errors import Aborted, GateRefused, JournalFailed, LinkError, MeasurementFault, VolcalError
from drivers.roles import TableImage
from twin.formats.estimate_file import format_estimate


@dataclass
class Progress:
    """What has been reached so far; filled in as the run goes, so that a fault loses nothing."""

    found: publish.FoundState | None = None
    prepared: Prepared | None = None
    measured: Measured | None = None
    finding: Finding | None = None
    gates: list[Gate] = field(default_factory=list)
    verified: Measured | None = None
    proof: Proof | None = None
    active_bank: int | None = None
    error: VolcalError | None = None


class CalibrationRun:
    """Carries out one `Job` on one open `Rig`."""

    def __init__(
        self,
        job: Job,
        rig: Rig,
        engine: Engine,
        journal: RunJournal,
        conduct: Conduct,
        supervisor: Supervisor,
    ) -> None:
        self._job = job
        self._rig = rig
        self._engine = engine
        self._journal = journal
        self._conduct = conduct
        self._supervisor = supervisor
        self.progress = Progress()

    def carry_out(self) -> Progress:
        """Run to a final state. Errors of the house end in `progress.error`, never in a traceback."""
        try:
            self._calibrate_or_refuse()
        except VolcalError as error:
            self.progress.error = error
            self._leave_safely(error)
        except BaseException as defect:
            # A defect of ours must be seen as one, but never before the machine is as it was found.
            self._leave_safely(VolcalError(f"defect in the agent: {defect!r}", hint="please report it"))
            raise
        return self.progress

    def _calibrate_or_refuse(self) -> None:
        try:
            self._calibrate()
        except GateRefused as refusal:
            self.progress.error = refusal
            self._journal.decision("refused", {"reason": str(refusal)})
            self._conduct.enter(RunState.REFUSED, str(refusal))

    def _calibrate(self) -> None:
        progress, enter = self.progress, self._conduct.enter
        enter(RunState.MEASURING)
        progress.found = self._engine.run(publish.read_state("before"))
        progress.active_bank = progress.found.bank
        self._journal.table("backup", progress.found.bank, progress.found.table)
        progress.prepared = prepared = self._engine.run(self._job.preparing())
        order = replace(self._job.measuring, standing_at=prepared.standing_at)
        progress.measured = self._engine.run(measure_positions(order, self._job.layout, prepared.rules))
        enter(RunState.IDENTIFYING)
        image = self._identify_and_gate(progress.measured, progress.found)
        enter(RunState.STAGING)
        bank = publish.choose_bank(self._rig.store.store_limits().banks, progress.found.bank)
        self._engine.run(publish.stage_table(bank, image))
        self._journal.table("staged", bank, image)
        enter(RunState.ACTIVATING)
        progress.active_bank = bank
        self._engine.run(publish.activate("activate", bank))
        enter(RunState.VERIFYING)
        self._verify(progress.measured)

    def _identify_and_gate(self, measured: Measured, found: publish.FoundState) -> TableImage:
        job, progress = self._job, self.progress
        correction = no_correction if found.table is None else table_of(found.table, job.tool_offset_mm).at
        with translated(MeasurementFault):
            finding = find_machine(job, job.balls_of(measured, held_out=False), correction)
        progress.finding = finding
        self._journal.estimate(format_estimate(finding.estimate, provenance(job, self._journal.run_id)))
        limits = self._rig.store.store_limits()
        predicted, before = finding.volumetric.after, finding.volumetric.before
        progress.gates += estimate_gates(finding.estimate, predicted, before, job.gate_limits)
        progress.gates += table_gates(finding.table, limits, job.gate_limits)
        for gate in progress.gates:
            self._journal.decision("gate", vars(gate))
        require(progress.gates)
        return image_of(finding.table, limits)

    def _verify(self, measured: Measured) -> None:
        job, progress = self._job, self.progress
        assert progress.finding is not None  # noqa: S101  identified before anything was staged
        order = job.verifying(measured.standing_at)
        rules = job.rules if progress.prepared is None else progress.prepared.rules
        progress.verified = self._engine.run(measure_positions(order, job.layout, rules, measured.standings))
        before = job.balls_of(measured, held_out=True)
        after = job.balls_of(progress.verified, held_out=True)
        progress.proof = prove(job, progress.finding, before, after)
        self._journal.decision("proof", vars(progress.proof))
        if progress.proof.accepted:
            self._conduct.enter(RunState.COMPLETE, progress.proof.reason)
            return
        self._conduct.enter(RunState.RESTORING, progress.proof.reason)
        self._restore(after_fault=False)
        self._conduct.enter(RunState.COMPLETE, f"restored: {progress.proof.reason}")

    def _leave_safely(self, error: VolcalError) -> None:
        """Stop, withdraw, restore; whatever cannot be done is said beside the first cause."""
        aborted = isinstance(error, Aborted)
        self._supervisor.shield()
        if isinstance(error, JournalFailed):
            self._engine = self._engine.without_journal()
        complaints = _attempt("record the state", lambda: self._conduct.enter(RunState.ABORTING, str(error)))
        complaints += self._rig.stop()
        if not isinstance(error, LinkError):
            complaints += _attempt("bring the axes to a standstill", self._rig.await_standstill)
            complaints += _attempt("withdraw the probe", self._withdraw)
        not_restored = self._attempt_restore()
        complaints += not_restored
        reason = "; ".join([str(error), *complaints])
        end = RunState.ABORTED if aborted and not not_restored else RunState.FAULTED
        _attempt("record the end", lambda: self._conduct.enter(end, reason))

    def _withdraw(self) -> None:
        probing = self._job.rules.probing
        self._engine.run(withdraw(self._job.rules.course, np.asarray(probing.stylus_axis), probing.retract_mm))

    def _attempt_restore(self) -> list[str]:
        """Empty where the former bank acts; a journal that fails on the way is done without."""
        found = self.progress.found
        if found is None or self.progress.active_bank == found.bank:
            return []
        try:
            self._restore(after_fault=True)
        except JournalFailed:
            self._engine = self._engine.without_journal()
            return self._attempt_restore()
        except VolcalError as failure:
            return [f"bank {found.bank} could not be made active again: {failure}"]
        return []

    def _restore(self, *, after_fault: bool) -> None:
        found = self.progress.found
        assert found is not None  # noqa: S101  read before anything is written
        self._engine.run(publish.restore(found.bank, after_fault=after_fault))
        self.progress.active_bank = found.bank
        _attempt("record what was restored", lambda: self._journal.table("restored", found.bank, found.table))


def _attempt(what: str, action: Callable[[], None]) -> list[str]:
    """The complaint where `action` fails; the first cause of the way out must not be lost over it."""
    try:
        action()
    except VolcalError as failure:
        return [f"could not {what}: {failure}"]
    return []
