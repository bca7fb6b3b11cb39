"""Results of a run, collected from the steps of its plan while the run is carried out."""

from __future__ import annotations

from dataclasses import dataclass, field

from agent.execution.steps import Conclude, Step
from agent.planning.job import Job
from agent.probing.preparation import PreparationResult
from agent.probing.publish import ActiveCompensation
from agent.probing.run_plan import VERIFIED, MeasuredPositions
from agent.results.estimation import EstimationResult
from agent.results.gates.gate import Gate
from agent.results.run_outcome import Confirmation, NightReport, Proof
from agent.results.trial_report import TrialReport
from drivers.errors import NotActiveYet, VolcalError


@dataclass(frozen=True)
class CheckedGates:
    """Gates of a result, with the consent that was given."""

    gates: tuple[Gate, ...]


@dataclass(frozen=True)
class BankInUse:
    """Conclusion before a bank is activated: from now on, `bank` may be active."""

    bank: int


@dataclass
class RunResults:
    """Results that a run has so far. They are collected during the run and are therefore not lost if the run fails.

    `found` is the compensation that was active at the start of the run. `active_bank` is the bank that may be active
    now. `job` is the job to which the positions in `measured` belong; it is None if this is the job with which the run
    began. `error` is the first error of a run that did not complete, or the reason why a written table is not yet
    active. `end_reason` states this error and what could not be done at the end, such as the restoration of the former
    table; it is empty for a run that ended otherwise.
    """

    found: ActiveCompensation | None = None
    prepared: PreparationResult | None = None
    measured: MeasuredPositions | None = None
    estimation: EstimationResult | None = None
    gates: tuple[Gate, ...] = field(default=())
    verified: MeasuredPositions | None = None
    proof: Proof | None = None
    confirmed: Confirmation | None = None
    night: NightReport | None = None
    trial: TrialReport | None = None
    active_bank: int | None = None
    job: Job | None = None
    error: VolcalError | None = None
    end_reason: str = ""

    def observe(self, step: Step, result: object) -> None:  # noqa: PLR0912  one case a type of conclusion
        """Take over the result of a conclusion; other steps have no results that are kept here."""
        if not isinstance(step, Conclude):
            return
        match result:
            case ActiveCompensation():
                self.found, self.active_bank = result, result.bank
            case PreparationResult():
                self.prepared = result
            case MeasuredPositions() if step.key == VERIFIED:
                self.verified = result
            case MeasuredPositions():
                self.measured = result
            case EstimationResult():
                self.estimation = result
            case CheckedGates():
                self.gates = result.gates
            case Proof():
                self.proof = result
            case Confirmation():
                self.confirmed = result
            case NightReport():
                self.night = result
            case TrialReport():
                self.trial = result
            case BankInUse():
                self.active_bank = result.bank
            case Job():
                self.job = result
            case NotActiveYet():
                self.error = result
