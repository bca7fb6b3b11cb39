"""What a run came to, and the one JSON object that a machine reads of it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from agent.execution.states import RunState


@dataclass(frozen=True)
class Proof:
    """Held-out positions with the new table: rms residual per ball, µm, before and after; χ² against prediction."""

    accepted: bool
    before_um: float
    after_um: float
    predicted_um: float
    chi2_normalised: float
    reason: str


@dataclass(frozen=True)
class Outcome:
    """State, figures and places. None: the run did not come so far."""

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
    rank: int | None = None
    parameters: int | None = None
    estimated_ve_um: float | None = None
    predicted_vce_um: float | None = None
    chi2_normalised: float | None = None
    rejected: tuple[tuple[int, int, int], ...] = ()
    proof: Proof | None = None
    reason: str = ""

    def as_json(self) -> dict[str, object]:
        """Keys as documented in docs/reference/json.md; `verified`: true, false, or null where not proved."""
        return {
            "state": self.state.value,
            "run_id": self.run_id,
            "position_set": self.position_set,
            "formulation": self.formulation,
            "balls": self.balls,
            "touches": self.touches,
            "machine_minutes": round(self.machine_minutes, 3),
            "predicted_minutes": None if self.predicted_minutes is None else round(self.predicted_minutes, 3),
            "wall_seconds": round(self.wall_seconds, 3),
            "rank": self.rank,
            "parameters": self.parameters,
            "estimated_ve_um": self.estimated_ve_um,
            "predicted_vce_um": self.predicted_vce_um,
            "chi2_normalised": self.chi2_normalised,
            "rejected": [list(row) for row in self.rejected],
            "verified": None if self.proof is None else self.proof.accepted,
            "verification": None
            if self.proof is None
            else {
                "before_um": self.proof.before_um,
                "after_um": self.proof.after_um,
                "predicted_um": self.proof.predicted_um,
                "chi2_normalised": self.proof.chi2_normalised,
                "reason": self.proof.reason,
            },
            "table_bank": self.table_bank,
            "report": None if self.report is None else str(self.report),
            "reason": self.reason,
        }
