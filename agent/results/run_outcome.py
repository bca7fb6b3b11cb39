"""Outcome of a run, and its form as a JSON object for other programs."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from pathlib import Path

from agent.execution.states import FINAL, RunState
from agent.probing.reversal import AxisReversal
from agent.results.estimation import NO_ESTIMATION, EstimationResult
from agent.results.facts import Quantity
from agent.results.homing_scatter import AfterHoming
from agent.results.night_changes import drift_document, jump_documents
from agent.results.run_time import RunTime
from agent.results.run_verdict import RunVerdict, verdict_of
from agent.results.trial_report import TrialReport
from twin.artefact.effect_test import NO_GAIN, REQUIRED_POWER
from twin.monitoring.constant_drift import FoundDrift
from twin.monitoring.step_detection import PossibleJump
from twin.monitoring.step_power import SmallestStep


@dataclass(frozen=True)
class Proof:
    """Result of the proof of a new compensation table at held-out positions.

    `before_um` and `after_um` are the rms residuals per ball before and after activation of the table. `predicted_um`
    is the prediction of `after_um`. `chi2_normalised` compares the residuals after activation with their prediction.

    `change` is the measured change of the residuals, and `gain` the decrease of their weighted square, each as a share
    of the predicted one (see `twin.artefact.effect_test`). Both must reach `limit`. `change_chi2_normalised` compares
    the change of the residuals with that of a table that is applied as written (see `twin.artefact.change_test`).
    """

    accepted: bool
    before_um: float
    after_um: float
    predicted_um: float
    chi2_normalised: float
    change: float
    gain: float
    limit: float
    change_chi2_normalised: float
    reason: str


@dataclass(frozen=True)
class Confirmation:
    """Confirmation of the active table, which is kept because a new table would not be better by the stated margin, or
    because its proof could not show that it is. A machine on which no table is active (`without_table`) stays so.

    `kept_um` and `new_um` are the volumetric errors expected with the active and with a new table, after removal of the
    best-fitting rigid motion. `min_gain` is the relative decrease from which a new table is written. `held_out_um` is
    the rms residual of the held-out balls with the active table. `chi2_normalised` compares them with the prediction of
    the estimate. `power` is the probability that the proof of a new table would accept it if it works; it is None if a
    new table would not be better by the margin. `reason` states why the active table is not confirmed; it is empty if
    it is.
    """

    kept_um: float
    new_um: float
    min_gain: float
    held_out_um: float
    chi2_normalised: float
    power: float | None
    reason: str = ""
    without_table: bool = False

    @property
    def text(self) -> str:
        """Explanation in one line."""
        if self.without_table and self.power is not None:
            return (
                f"{Decision.CONFIRMED.value}: the machine stays without a table; {no_gain_text(self.power)}; VE "
                f"{self.kept_um:.2f} µm, with a table {self.new_um:.2f} µm expected"
            )
        if self.without_table:
            return (
                f"{Decision.CONFIRMED.value}: the machine stays without a table, VE {self.kept_um:.2f} µm; a table is "
                f"expected to leave {self.new_um:.2f} µm; it is written only if it lowers the VE by "
                f"{100.0 * self.min_gain:.0f} % or more"
            )
        if self.power is not None:
            return (
                f"{Decision.CONFIRMED.value}: {no_gain_text(self.power)}; VE {self.kept_um:.2f} µm, with a new table "
                f"{self.new_um:.2f} µm expected"
            )
        return (
            f"{Decision.CONFIRMED.value}: the active compensation is kept, VE {self.kept_um:.2f} µm; a new table is "
            f"expected to leave {self.new_um:.2f} µm; it is written only if it lowers the VE by "
            f"{100.0 * self.min_gain:.0f} % or more"
        )


def no_gain_text(power: float) -> str:
    """Return why the active compensation is kept if the proof of a new table would accept it with the probability
    `power` only."""
    return (
        f"{NO_GAIN}: held-out positions would prove a new table that works with a probability of "
        f"{100.0 * power:.0f} %, {100.0 * REQUIRED_POWER:.0f} % needed"
    )


class Decision(Enum):
    """Decision that ends a run. CONFIRMED ends a calibration that keeps the active table; all others end a nightly run
    or a verification."""

    WITHIN = "within limits"
    OUT = "out of limits"
    FUSED = "fused, table kept"
    WRITTEN = "fused, table written"
    RESTORED = "former table restored"
    FULL_NEEDED = "full calibration needed"
    FULL_DONE = "full calibration done"
    CONFIRMED = "confirmed"


@dataclass(frozen=True)
class SuspectedError:
    """Error motion or squareness of the machine that may have changed suddenly (jumped).

    `error` is the name of the error motion or squareness according to ISO 230-1. `change` is the size of the jump in
    `unit`. `evidence` is the natural logarithm of the likelihood ratio in favour of the jump.
    """

    error: str
    change: float
    unit: str
    evidence: float

    @property
    def text(self) -> str:
        return f"{self.error} changed by {self.change:+.1f} {self.unit}"


_OBJECTS = ("decision", "jumped", "likeliest", "alternatives", "drift", "finds")
"""Fields of a night whose JSON is not their value."""


@dataclass(frozen=True)
class NightReport:
    """Comparison of the machine with the last accepted night, and the decision of a nightly run or verification.

    `since` is the identity of the run of the last accepted night, and `nights` is the number of nights since then.

    Three values are volumetric errors after removal of the best-fitting rigid motion. `ve_before_um` was expected with
    the active table at the end of the last accepted night. `ve_now_um` is expected with the active table now.
    `ve_after_um` is expected with a table made from the present estimate.

    `held_out_um` is the rms residual of the held-out balls at displayed axis positions, and `held_out_predicted_um` is
    its prediction. `chi2_normalised` compares all ball centres with their prediction.

    Three values compare a fused night with the nights before. `fit_probability` is the probability of a night that
    contradicts their prediction as much as this one or more. `drift_factor` is the factor by which the machine drifts
    more or less than stated, as learned from all nights. `warning` is empty if the night fits.

    `jumped` lists the machine errors for which there is sufficient evidence of a jump (sudden change). `likeliest`
    lists the errors whose jump would best explain the measurement, the likeliest first. It is filled even if the
    evidence is not sufficient. `alternatives` lists the errors that may have jumped if only one has, with their
    probabilities; it is empty if `jumped` is.

    `drift` is the drift of one error in one direction that a fused night and those before show; None if there is none.

    `finds` is the smallest step of a squareness that a verification finds with 95 %, of the squareness that it finds
    worst; None if no squareness can change, and for a night that did not only verify.
    """

    decision: Decision
    since: str
    nights: float
    station: int
    positions: int
    reason: str = ""
    ve_before_um: float | None = None
    ve_now_um: float | None = None
    ve_after_um: float | None = None
    held_out_um: float | None = None
    held_out_predicted_um: float | None = None
    chi2_normalised: float | None = None
    fit_probability: float | None = None
    drift_factor: float | None = None
    warning: str = ""
    jumped: tuple[SuspectedError, ...] = ()
    likeliest: tuple[SuspectedError, ...] = ()
    alternatives: tuple[PossibleJump, ...] = ()
    drift: FoundDrift | None = None
    finds: SmallestStep | None = None

    def as_json(self) -> dict[str, object]:
        """Return this comparison as the JSON object that docs/reference/json.md describes."""
        return {
            **{name: value for name, value in vars(self).items() if name not in _OBJECTS},
            "decision": self.decision.value,
            "jumped": [vars(one) for one in self.jumped],
            "likeliest": [vars(one) for one in self.likeliest],
            "alternatives": jump_documents(self.alternatives),
            "drift": drift_document(self.drift),
            "finds": None if self.finds is None else vars(self.finds),
        }


@dataclass(frozen=True)
class Outcome:
    """State, results and report of a run. A field is None if the run ended before the field was set.

    `after_homing` is the effect of the next homing; it is None if the scatter of the homing has never been measured, or
    if the run has no estimate.
    """

    state: RunState
    run_id: str
    position_set: str
    formulation: str
    balls: int
    touches: int
    machine_minutes: float
    wall_seconds: float
    predicted_minutes: float | None
    table_bank: int | None
    report: Path | None
    estimation: EstimationResult | None = None
    proof: Proof | None = None
    confirmed: Confirmation | None = None
    night: NightReport | None = None
    trial: TrialReport | None = None
    reversal: tuple[AxisReversal, ...] = ()
    kind: str = "calibrate"
    reason: str = ""
    link_interruptions: int = 0
    run_time: RunTime | None = None
    after_homing: AfterHoming | None = None

    @property
    def ve_now(self) -> Quantity | None:
        """Volumetric error expected with the confirmed table, with the table that a night has kept, or else with the
        new one; None if the proof of the new table has failed, or if nothing is expected."""
        if self.confirmed is not None:
            return Quantity(self.confirmed.kept_um)
        if self.night is not None and (self.proof is None or not self.proof.accepted):
            return None if self.night.ve_now_um is None else Quantity(self.night.ve_now_um)
        if self.proof is not None and not self.proof.accepted:
            return None
        return None if self.estimation is None else self.estimation.volumetric.after_aligned

    @property
    def verdict(self) -> RunVerdict:
        decision = self.night.decision if self.night is not None else Decision.CONFIRMED if self.confirmed else None
        return verdict_of(
            self.kind,
            self.state.value,
            ended=self.state in FINAL,
            accepted=None if self.proof is None else self.proof.accepted,
            decision=None if decision is None else decision.value,
        )

    @property
    def after_homing_record(self) -> dict[str, object] | None:
        """JSON object about the accuracy after the next homing; None if it is not known."""
        after, ve = self.after_homing, self.ve_now
        return None if after is None or ve is None else after.as_json(ve)

    def as_json(self) -> dict[str, object]:
        """Return this outcome as the JSON object that docs/reference/json.md describes. `verified` is null if no new
        table was proved."""
        return {
            "kind": self.kind,
            "state": self.state.value,
            "verdict": self.verdict.as_json(),
            "run_id": self.run_id,
            "position_set": self.position_set,
            "formulation": self.formulation,
            "balls": self.balls,
            "touches": self.touches,
            "machine_minutes": round(self.machine_minutes, 3),
            "predicted_minutes": None if self.predicted_minutes is None else round(self.predicted_minutes, 3),
            "run_time": None if self.run_time is None else self.run_time.as_json(),
            "wall_seconds": round(self.wall_seconds, 3),
            "link_interruptions": self.link_interruptions,
            **(NO_ESTIMATION if self.estimation is None else self.estimation.as_json()),
            "verified": None if self.proof is None else self.proof.accepted,
            "verification": None
            if self.proof is None
            else {
                "before_um": self.proof.before_um,
                "after_um": self.proof.after_um,
                "predicted_um": self.proof.predicted_um,
                "chi2_normalised": self.proof.chi2_normalised,
                "change": self.proof.change,
                "gain": self.proof.gain,
                "limit": self.proof.limit,
                "change_chi2_normalised": self.proof.change_chi2_normalised,
                "reason": self.proof.reason,
            },
            "confirmed": None
            if self.confirmed is None
            else {
                "ve_kept_um": self.confirmed.kept_um,
                "ve_new_um": self.confirmed.new_um,
                "min_gain": self.confirmed.min_gain,
                "held_out_um": self.confirmed.held_out_um,
                "chi2_normalised": self.confirmed.chi2_normalised,
                "power": self.confirmed.power,
            },
            "night": None if self.night is None else self.night.as_json(),
            "trial": None if self.trial is None else self.trial.as_json(),
            "reversal": [dict(vars(axis)) for axis in self.reversal],
            "after_homing": self.after_homing_record,
            "table_bank": self.table_bank,
            "report": None if self.report is None else str(self.report),
            "reason": self.reason,
        }
