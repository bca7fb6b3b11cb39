"""Guarded run, the base class of all runs. If a guarded run does not succeed, it leaves the machine as it was found."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from agent.errors import Aborted, GateRefused, JournalFailed, PlanDiverged, PlanRefused
from agent.execution.states import RunState
from agent.execution.steps import Step
from agent.planning.job import Job
from agent.probing import publish
from agent.probing.position import PositionRules
from agent.probing.preparation import PreparationResult
from agent.probing.recovery import withdraw
from agent.probing.run_plan import MeasuredPositions
from agent.results.estimation import EstimationResult
from agent.results.gates import Gate
from agent.results.journal_entries import record_probe
from agent.results.observations import Correction, no_correction
from agent.results.run_outcome import Confirmation, NightReport, Proof
from agent.results.table_image import table_of
from agent.results.trial_report import TrialReport
from agent.runs.run_context import RunContext
from drivers.errors import LinkError, VolcalError
from drivers.roles import Activation


@dataclass
class RunProgress:
    """Results that a run has so far. They are stored during the run and are therefore not lost if the run fails.

    `found` is the compensation that was active at the start of the run. `job` is the job to which the positions in
    `measured` belong; it is None if this is the job with which the run began.
    """

    found: publish.ActiveCompensation | None = None
    prepared: PreparationResult | None = None
    measured: MeasuredPositions | None = None
    estimation: EstimationResult | None = None
    gates: list[Gate] = field(default_factory=list)
    verified: MeasuredPositions | None = None
    proof: Proof | None = None
    confirmed: Confirmation | None = None
    night: NightReport | None = None
    trial: TrialReport | None = None
    active_bank: int | None = None
    job: Job | None = None
    error: VolcalError | None = None


class GuardedRun(ABC):
    """Base class of runs. If a run does not accept a new table, it restores the compensation that was active at its
    start and checks that this compensation is active."""

    def __init__(self, job: Job, context: RunContext) -> None:
        self._job = job
        self._rig = context.rig
        self._engine = context.engine
        self._journal = context.journal
        self._tracker = context.tracker
        self._supervisor = context.supervisor
        self._clock = context.clock
        self.progress = RunProgress()

    @abstractmethod
    def _work(self) -> None:
        """Do all work up to a final state. Raise GateRefused if the run decides not to continue."""

    def carry_out(self) -> RunProgress:
        """Carry out the run until it reaches a final state, and return its results. A `VolcalError` (base class of the
        program's own errors) is not raised but stored in `progress.error`."""
        try:
            self._work_or_refuse()
        except VolcalError as error:
            self.progress.error = error
            self._leave_safely(error)
        except BaseException as defect:
            # A defect of the agent must become visible, but only once the machine is as it was found.
            self._leave_safely(VolcalError(f"defect in the agent: {defect!r}", hint="please report it"))
            raise
        return self.progress

    def _work_or_refuse(self) -> None:
        try:
            self._work()
        except GateRefused as refusal:
            self.progress.error = refusal
            self._journal.decision("refused", {"reason": str(refusal)})
            self._tracker.enter(RunState.REFUSED, str(refusal))

    def _begin(self) -> publish.ActiveCompensation:
        """Read, journal and return the active compensation before anything moves."""
        self._tracker.enter(RunState.MEASURING)
        found = self.progress.found = self._engine.run(publish.read_state("before"))
        self.progress.active_bank = found.bank
        self._journal.table("backup", found.bank, found.table)
        return found

    def _prepare_probe(self) -> PreparationResult:
        """Check and qualify the probe. The result is valid for all later measurements of the run."""
        prepared = self.progress.prepared = self._engine.run(self._job.preparation_plan())
        record_probe(self._journal, prepared)
        return prepared

    def too_late(self, following: Step) -> PlanRefused | None:
        """Return an error if too little time is left to resume the run, and None otherwise. `following` is the first
        step of the resumed run that moves the machine."""
        return None

    @property
    def activation(self) -> Activation:
        """Event after which the controller uses a bank (memory for one compensation table) that has been activated."""
        return self._rig.store.store_limits().activation

    @property
    def rules(self) -> PositionRules:
        """Rules of measurement. If the stylus has been qualified in this run, the rules contain the qualified
        stylus."""
        prepared = self.progress.prepared
        return self._job.rules if prepared is None else prepared.rules

    @property
    def _correction(self) -> Correction:
        """Correction that the table active at the start adds to displayed axis positions."""
        found = self.progress.found
        assert found is not None  # noqa: S101  read before anything is measured
        return no_correction if found.table is None else table_of(found.table, self._job.tool_offset_mm).at

    def _leave_safely(self, error: VolcalError) -> None:
        """Stop the machine, withdraw the probe and restore the compensation.

        Failures of these actions are added to the reason of the final state, after `error`.
        """
        aborted = isinstance(error, Aborted)
        self._supervisor.shield()
        self._engine, self._journal = self._engine.aside(), self._journal.aside()
        if isinstance(error, JournalFailed):
            self._engine = self._engine.without_journal()
        complaints = attempt("record the state", lambda: self._tracker.enter(RunState.ABORTING, str(error)))
        complaints += self._rig.stop()
        complaints += attempt("bring the axes to a standstill", self._rig.await_standstill)
        if not isinstance(error, (LinkError, PlanDiverged)):
            complaints += attempt("withdraw the probe", self._withdraw)
        not_restored = self._attempt_restore()
        complaints += not_restored
        reason = "; ".join([str(error), *complaints])
        end = RunState.ABORTED if aborted and not not_restored else RunState.FAULTED
        attempt("record the end", lambda: self._tracker.enter(end, reason))

    def _withdraw(self) -> None:
        probing = self._job.rules.probing
        last_motion = self._rig.last_motion
        self._engine.run(
            withdraw(self._job.rules.retreat, np.asarray(probing.stylus_axis), probing.retract_mm, last_motion)
        )

    def _attempt_restore(self) -> list[str]:
        """Activate the former bank.

        If the journal fails, this is done without the journal. Return error texts, empty on success.
        """
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
        self._engine.run(publish.restore(found.bank, after_fault=after_fault, activation=self.activation))
        self.progress.active_bank = found.bank
        attempt("record what was restored", lambda: self._journal.table("restored", found.bank, found.table))


def attempt(what: str, action: Callable[[], None]) -> list[str]:
    """Carry out `action`. Return an empty list if it succeeds, and a list with its error text if it raises
    `VolcalError`.

    The error is not raised, because it would replace an earlier error that is being handled. `what` completes the text
    "could not …".
    """
    try:
        action()
    except VolcalError as failure:
        return [f"could not {what}: {failure}"]
    return []
