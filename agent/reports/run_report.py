"""Report data of a run, taken from the run's record in the journal.

Values on which decisions were based are not computed again. The estimate, the residuals and the summary values are
taken from the record.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from agent.execution.run_record import RunRecord
from agent.files import translated
from agent.reports.journal_estimate import journal_estimate
from agent.reports.night_facts import night_facts
from agent.reports.page import (
    Header,
    IdentificationData,
    Provenance,
    QuestionFacts,
    ReportData,
    RunFacts,
    TemperatureTrace,
    VerificationFacts,
    VerifiedPosition,
    name_of_positions,
)
from agent.reports.page.texts import ENGLISH, Texts
from agent.reports.shown_events import drifts_um, shown_events
from agent.results.artefact_calibration import calibration_warnings
from agent.results.decision_kinds import HELD_OUT, IDENTIFIED, INPUTS, OUTCOME, PROBE
from agent.results.facts import ArtefactFacts, ProbeFacts, ProbeRing, Quantity, TableFacts, VolumetricSummary
from agent.results.gates import Gate
from agent.results.travel_parts import TravelParts
from agent.thermal.thermometer import ThermometerFacts
from drivers.errors import InputError
from twin.artefact.observations import Observations
from twin.artefact.position_set import Position
from twin.formats.estimate_file import StoredEstimate, parse_estimate

TITLES = {"calibrate": "Calibration", "verify": "Verification", "nightly": "Night", "try": "Trial of one ball"}


def report_of(record: RunRecord, trend: str = "", texts: Texts = ENGLISH) -> ReportData:
    """Return the report data of a run that has ended or was interrupted.

    `trend` is an SVG that shows the main results of all runs up to this run. Raises InputError if the run did not
    record its inputs (machine, artefact and input files).
    """
    inputs = record.decision(INPUTS)
    if inputs is None:
        raise InputError(
            "the journal does not contain the machine and artefact of this run",
            run=record.run_id,
            hint="the run ended before its preflight",
        )
    tool = record.settings["tool"]
    found = _found(record)
    return ReportData(
        header=_header(record, found),
        machine=inputs["machine"],
        artefact=ArtefactFacts(**inputs["artefact"]),
        tool_name=tool,
        tool_offset=tuple(inputs["tools_mm"][tool]),
        identification=found,
        gates=_gates(record),
        warnings=_warnings(record, found, texts),
        run=_facts(record, inputs, trend),
    )


def _header(record: RunRecord, found: IdentificationData | None) -> Header:
    settings = record.settings
    chosen = settings["identification"]
    identified = record.decision(IDENTIFIED)
    shown = {
        "Prior": "machine family" if chosen["prior"] else "none",
        "Weights": "full covariances" if chosen["weights"] == "full" else "equal",
        "Touches per ball": str(settings["procedure"]["touches_per_ball"]),
    }
    if identified is not None:
        shown["Legendre order"] = identified["order"]
    asked_for = settings["procedure"]["position_set"]
    return Header(
        title=TITLES.get(record.kind, record.kind),
        run_id=record.run_id,
        timestamp=record.ended or record.started,
        software_version=record.software,
        state=record.state if record.ended else f"{record.state}, interrupted",
        position_set=Path(asked_for).name if found is None else name_of_positions(found.positions),
        settings=shown,
    )


def _found(record: RunRecord) -> IdentificationData | None:
    identified = record.decision(IDENTIFIED)
    if identified is None or record.estimate is None:
        return None
    return IdentificationData(
        observations=Observations(**identified["observations"]),
        estimate=journal_estimate(_stored(record), identified["unresolved_mm2"]),
        residuals_mm=np.array(identified["residuals_mm"], dtype=np.float64),
        positions=measured_positions(record),
        volumetric=_volumetric(identified["volumetric"]),
        table=TableFacts(**identified["table"]),
        thermometer=ThermometerFacts(**identified["thermometer"]),
        travel=TravelParts.from_record(identified["travel"]),
    )


def _volumetric(record: Mapping[str, Any]) -> VolumetricSummary:
    before, after = _quantity(record["before_aligned"]), _quantity(record["after_aligned"])
    return VolumetricSummary(before, after, record["table_ve_um"])


def _quantity(record: Mapping[str, Any]) -> Quantity:
    limits = record["limits_um"]
    return Quantity(record["value_um"], record["standard_uncertainty_um"], None if limits is None else tuple(limits))


def measured_positions(record: RunRecord) -> tuple[Position, ...]:
    """Return the positions to which the position numbers in the run's estimate refer; empty if the run has no
    estimate."""
    return tuple(Position(*place) for place in (record.decision(IDENTIFIED) or {"positions": ()})["positions"])


def _stored(record: RunRecord) -> StoredEstimate:
    with translated(InputError):
        return parse_estimate(record.estimate or "", f"estimate of run {record.run_id}")


def _gates(record: RunRecord) -> tuple[Gate, ...]:
    """Return each gate with its last verdict, in the order in which the gates were first evaluated."""
    gates = {note.record["name"]: Gate(**note.record) for note in record.decisions if note.kind == "gate"}
    return tuple(gates.values())


def _facts(record: RunRecord, inputs: Mapping[str, Any], trend: str) -> RunFacts:
    outcome = record.decision(OUTCOME) or {}
    probe = record.decision(PROBE)
    return RunFacts(
        touches=outcome.get("touches", record.touches),
        machine_minutes=outcome.get("machine_minutes", record.minutes),
        balls=record.balls,
        reason=record.reason,
        times=(
            ("Started", _readable_time(record.started)),
            ("Ended", _readable_time(record.ended) if record.ended else "interrupted"),
        ),
        banks=_banks(record, outcome),
        verification=_verification(record),
        night=night_facts(record),
        temperatures=_temperatures(record),
        drifts_um=drifts_um(record),
        questions=tuple(
            QuestionFacts(one.minute, one.text, True if one.answered else False if one.error else None, one.error)
            for one in record.questions
        ),
        provenance=_provenance(record, inputs),
        events=shown_events(record),
        probe=None if probe is None else _probe(probe["facts"]),
        trend=trend,
    )


def _readable_time(stamp: str) -> str:
    return stamp.replace("T", " ")[:19] + " UTC"


def _banks(record: RunRecord, outcome: Mapping[str, Any]) -> tuple[tuple[str, str], ...]:
    """Return rows (name, text) on the previous table, the table written, and the bank active at the end."""
    rows = []
    for role, name in (("backup", "Previous table"), ("staged", "Table written")):
        table = record.table(role)
        if table is not None:
            rows.append((name, f"bank {table.bank}, {_checksum(table.crc32)}"))
    if outcome.get("table_bank") is not None:
        rows.append(("Active bank at the end", str(outcome["table_bank"])))
    return tuple(rows)


def _checksum(crc32: int | None) -> str:
    return "no compensation" if crc32 is None else f"CRC-32 of the counts {crc32:08x}"


def _verification(record: RunRecord) -> VerificationFacts | None:
    proof, rows = record.decision("proof"), record.decision(HELD_OUT)
    if proof is None:
        return None
    positions = (
        () if rows is None else tuple(_verified_position(row, proof["predicted_um"]) for row in rows["positions"])
    )
    verdict = f"{proof['reason']}; normalised χ² {proof['chi2_normalised']:.2f}"
    before, after = (Quantity(proof[name]) for name in ("before_um", "after_um"))
    least_known = record.settings["verification"]["positions_deg"] is None
    return VerificationFacts(proof["accepted"], verdict, before, after, proof["predicted_um"], positions, least_known)


def _verified_position(row: Mapping[str, Any], predicted_um: float) -> VerifiedPosition:
    station, azimuth, elevation = row["position"]
    label = f"station {station}, az {azimuth:g}°, el {elevation:g}°"
    return VerifiedPosition(label, row["before_um"], row["after_um"], predicted_um)


def _temperatures(record: RunRecord) -> tuple[TemperatureTrace, ...]:
    names = sorted({name for _, values in record.temperatures for name in values})
    traces = []
    for name in names:
        rows = [(minutes, values[name]) for minutes, values in record.temperatures if name in values]
        minutes, values = np.array(rows).T
        traces.append(TemperatureTrace(name, minutes, values))
    return tuple(traces)


def _probe(facts: Mapping[str, Any]) -> ProbeFacts:
    rings = tuple(
        ProbeRing(ring["latitude_deg"], *(np.array(ring[name]) for name in _RING_ARRAYS)) for ring in facts["rings"]
    )
    return ProbeFacts(tuple((name, text) for name, text in facts["rows"]), rings)


_RING_ARRAYS = ("angle_deg", "residual_um", "map_angle_deg", "map_um")


def _provenance(record: RunRecord, inputs: Mapping[str, Any]) -> Provenance:
    asked = record.event("asked") or {}
    return Provenance(
        started_by=str(asked.get("source", "command line")),
        files=tuple((file["name"], file["sha256"]) for file in inputs["files"]),
        settings_sha256=hashlib.sha256(record.settings_text.encode()).hexdigest(),
    )


def _warnings(record: RunRecord, found: IdentificationData | None, texts: Texts) -> tuple[str, ...]:
    notes = list((record.decision(PROBE) or {}).get("warnings", ()))
    if found is None:
        return tuple(notes)
    if found.table is not None and found.table.extrapolated:
        notes.append(texts["extrapolated"].format(share=f"{100.0 * found.table.extrapolated / found.table.cells:.0f}"))
    if found.thermometer is not None and found.thermometer.warning is not None:
        notes.append(found.thermometer.warning)
    if record.decision("proof") is None:
        notes.append(texts["prediction_only"])
    notes += calibration_warnings(found.estimate.artefact_calibration)
    at_bounds = _stored(record).document.scales_at_bounds
    return (*notes, *(texts["scale_at_bounds"].format(text=text[0].upper() + text[1:]) for text in at_bounds))
