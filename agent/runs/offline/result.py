"""Result of an identification from files."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from agent.results.estimation import (
    EstimationResult,
)
from agent.results.gates.gate import Gate
from agent.results.gates.night_gate import night_document
from agent.results.gates.required_gates import names_of_failed, reasons, require_passed
from agent.runs.offline.material import IdentificationInput
from twin.formats.estimate_file import certificate_document


@dataclass(frozen=True)
class IdentificationResult:
    """Result of an identification from files. `report` is the path of the report, None if none was asked for, and
    `table_file` that of the table. `even_so` is True if the table is written although a gate did not pass."""

    run_id: str
    timestamp: str
    position_set: str
    material: IdentificationInput
    estimation: EstimationResult
    gates: tuple[Gate, ...]
    table_file: Path
    report: Path | None = None
    even_so: bool = False

    @property
    def failed(self) -> tuple[str, ...]:
        """Names of the gates that did not pass."""
        return names_of_failed(self.gates)

    @property
    def has_table(self) -> bool:
        return self.even_so or not self.failed

    def require_table(self) -> None:
        """Raise GateRefused if no table was written because a gate did not pass. The message names each such gate."""
        if not self.has_table:
            require_passed(self.gates, ". `--even-so` writes the table with a mark")

    def as_json(self, wall_seconds: float) -> dict[str, Any]:
        """Return the result as a JSON object with the keys that the JSON object of a run's outcome has. A value that
        exists only for a run on a machine is None."""
        estimate = self.estimation.estimate
        return {
            **self.estimation.as_json(),
            "state": "complete" if self.has_table else "refused",
            "run_id": self.run_id,
            "machine": self.material.machine.name,
            "artefact": self.material.artefact.name,
            "position_set": self.position_set,
            "formulation": estimate.formulation,
            "balls": self.material.balls.observations.size,
            "touches": None,
            "machine_minutes": None,
            "wall_seconds": round(wall_seconds, 3),
            "orders": dict(estimate.model.orders),
            "order_evidence": {str(entry.order): entry.relative_log for entry in estimate.order_evidence},
            "predicted_vce_raw_um": None,
            "verified": None,
            "table_bank": None,
            "report": None if self.report is None else str(self.report),
            "rejected": [list(row) for row in self.material.balls.as_numbered(estimate.rejected)],
            "certificate": certificate_document(estimate.certificate_check),
            "gates": {gate.name: gate.passed for gate in self.gates},
            "night": None if self.material.night is None else night_document(self.material.night),
            "table": str(self.table_file) if self.has_table else None,
            "reason": reasons(self.gates),
        }
