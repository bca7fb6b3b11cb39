"""Conversion of a run's record in the journal to rows of the history database. The history database itself is not
accessed.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from agent.execution.run_record import RunRecord
from agent.execution.stored_json import damage_reported, stored_json
from agent.results.decision_kinds import CONFIRMED, IDENTIFIED, INPUTS, OUTCOME, PROOF
from agent.results.run_requester import requester_of
from agent.results.run_verdict import run_figures
from drivers.errors import InputError
from twin.units import MICRO_UNITS

STORED_DECISIONS = frozenset(
    {"gate", PROOF, CONFIRMED, "night", "verify", "accepted", "refused", "full-calibration-needed"}
    | {"activate/activated", "restore/activated", "publish/staged"}
)
"""Kinds of decisions stored in the history. The large records of a run are only in its journal."""
_TOO_BIG = ("written",)
"""Format of the estimates whose parameters are converted. The module that reads them is imported for them alone."""


@dataclass(frozen=True)
class RunRows:
    """Rows of one run for the history database.

    `run` contains the columns of the run's row (those of `StoredRun` except the digest) and their values. `parameters`,
    `temperatures` and `decisions` contain the rows for the database tables that store these values of a run.
    """

    run: Mapping[str, Any]
    parameters: tuple[Mapping[str, Any], ...]
    temperatures: tuple[Mapping[str, Any], ...]
    decisions: tuple[Mapping[str, Any], ...]

    @property
    def digest(self) -> str:
        return hashlib.sha256(json.dumps(asdict(self), sort_keys=True).encode()).hexdigest()


def machine_name(settings: Mapping[str, Any]) -> str:
    """Return the name that the machine has in the history database, from the section `history` of the settings.

    If this section contains no name, return the name of the machine file without its suffix.
    """
    named = settings.get("history", {}).get("machine")
    return str(named or Path(settings["machine"]).stem)


def run_rows(record: RunRecord) -> RunRows:
    with damage_reported(InputError):
        estimate = None if record.estimate is None else stored_json(record.estimate)
        parameters = _parameters(estimate)
        return RunRows(_run(record, estimate), parameters, _temperatures(record), _decisions(record))


def _run(record: RunRecord, estimate: Mapping[str, Any] | None) -> dict[str, Any]:
    settings = record.settings
    outcome = record.decision(OUTCOME) or {}
    staged = record.table("staged")
    return {
        "machine": machine_name(settings),
        "run_id": record.run_id,
        "kind": record.kind,
        "started": record.started,
        "ended": record.ended,
        "state": record.state,
        "reason": record.reason,
        "software": record.software,
        "started_by": _started_by(record),
        "artefact": (record.decision(INPUTS) or {}).get("artefact", {}).get("name", Path(settings["artefact"]).stem),
        "position_set": Path(settings["procedure"]["position_set"]).name,
        "balls": record.balls,
        "touches": record.touches,
        "machine_minutes": outcome.get("machine_minutes", round(record.minutes, 3)),
        "predicted_minutes": outcome.get("predicted_minutes"),
        "rank": None if estimate is None else estimate["rank"],
        "chi2_normalised": None if estimate is None else estimate["chi2_normalised"],
        "table_bank": outcome.get("table_bank"),
        "table_crc32": None if staged is None or staged.crc32 is None else f"{staged.crc32:08x}",
        "settings_sha256": record.settings_sha256,
        **_errors(record, outcome),
    }


def _started_by(record: RunRecord) -> str:
    """Return who asked first for the run. A run that was resumed has several requests."""
    asked = [note.record for note in record.events if note.kind == "asked"]
    return requester_of(asked[0] if asked else None)


def _errors(record: RunRecord, outcome: Mapping[str, Any]) -> dict[str, Any]:
    """Return the columns with the volumetric errors, the held-out balls and the decisions about the table."""
    volumetric = (record.decision(IDENTIFIED) or {}).get("volumetric", {})
    before, after = volumetric.get("before_aligned", {}), volumetric.get("after_aligned", {})
    proof = record.decision(PROOF) or {}
    night = outcome.get("night") or record.decision("night") or record.decision("verify") or {}
    figures = run_figures(record.state, record.decision)
    return {
        "ve_before_um": figures.ve_um,
        "ve_before_sigma_um": before.get("standard_uncertainty_um"),
        "ve_after_um": after.get("value_um"),
        "ve_after_sigma_um": after.get("standard_uncertainty_um"),
        "ve_now_um": (outcome.get("confirmed") or {}).get("ve_kept_um", night.get("ve_now_um")),
        "acting_um": figures.vce_um,
        "held_out_before_um": figures.held_out_before_um,
        "held_out_after_um": figures.held_out_after_um,
        "held_out_predicted_um": proof.get("predicted_um", night.get("held_out_predicted_um")),
        "accepted": figures.accepted,
        "night": figures.decision,
        "since": night.get("since"),
        "nights": night.get("nights"),
    }


def _parameters(estimate: Mapping[str, Any] | None) -> tuple[Mapping[str, Any], ...]:
    """Return one row for each parameter of the estimate."""
    if estimate is None:
        return ()
    rows = []
    for place, parameter in enumerate(estimate["parameters"]):
        unit, factor = MICRO_UNITS[parameter["unit"]]
        rows.append(
            {
                "name": parameter["name"],
                "place": place,
                "value": factor * parameter["value"],
                "standard_uncertainty": factor * parameter["standard_uncertainty"],
                "unit": unit,
            }
        )
    return tuple(rows)


def _temperatures(record: RunRecord) -> tuple[Mapping[str, Any], ...]:
    found: dict[str, list[float]] = {}
    for _, values in record.temperatures:
        for sensor, value in values.items():
            found.setdefault(sensor, []).append(value)
    return tuple(
        {"sensor": sensor, "lowest": min(values), "mean": sum(values) / len(values), "highest": max(values)}
        for sensor, values in sorted(found.items())
    )


def _decisions(record: RunRecord) -> tuple[Mapping[str, Any], ...]:
    kept = [note for note in record.decisions if note.kind in STORED_DECISIONS]
    return tuple(
        {
            "place": place,
            "at": note.at,
            "kind": note.kind,
            "record": _to_json({name: value for name, value in note.record.items() if name not in _TOO_BIG}),
        }
        for place, note in enumerate(kept)
    )


def _to_json(record: Mapping[str, Any]) -> str:
    """Return a record as JSON text in the format of the journal. The record was read from JSON, so it contains no numpy
    values.
    """
    return json.dumps(record, separators=(",", ":"), allow_nan=False)
