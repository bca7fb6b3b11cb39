"""Report data of a run, taken from the run's record in the journal.

Values on which decisions were based are not computed again. The estimate, the residuals and the summary values are
taken from the record.

At the end of every position, the first ball is measured again, and its displacement is recorded. The report summarises
all these displacements in one line, and lists a single displacement only if it exceeds a limit. The report lists every
event that required a decision.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from agent.execution.journal_rows import EventRow
from agent.execution.run_record import RunRecord
from agent.execution.stored_gates import gate_records
from agent.files import translated
from agent.language.records import record_in_words
from agent.language.sentences import as_it_is
from agent.reports.page import (
    EventLine,
    Header,
    IdentificationData,
    NightFacts,
    Provenance,
    QuestionFacts,
    ReportData,
    RunFacts,
    TemperatureTrace,
    VerificationFacts,
    VerifiedPosition,
    name_of_positions,
)
from agent.reports.page.data import JournalEstimate, ReportedEstimate
from agent.reports.page.number_format import COVERAGE, fixed
from agent.reports.page.texts import ENGLISH, Texts
from agent.results.artefact_calibration import calibration_warnings
from agent.results.decision_kinds import HELD_OUT, IDENTIFIED, INPUTS, OUTCOME, PROBE
from agent.results.estimation import table_grid
from agent.results.facts import ArtefactFacts, ProbeFacts, ProbeRing, Quantity, TableFacts, VolumetricSummary
from agent.results.gates.gate import Gate
from agent.results.homing_scatter import HomingScatter, after_homing_text
from agent.results.run_outcome import Decision
from agent.results.run_requester import BY, requester_of
from agent.results.run_verdict import RunVerdict, run_figures
from agent.results.travel_parts import TravelParts
from agent.settings.report import ReportSettings
from agent.settings.schema import TableSettings
from agent.thermal.thermometer import ThermometerFacts
from agent.workpiece.measured_repeats import repeats_of
from agent.workpiece.predicted_tests import PlaceOfTests, PredictedTests, predicted_tests
from drivers.errors import InputError
from twin.artefact.observations import Observations
from twin.artefact.position_set import Position
from twin.artefact.touch_pattern import RADIUS_PATTERN
from twin.compensation.table import build_table
from twin.errors import TwinError
from twin.formats.estimate_file import StoredEstimate, parse_estimate
from twin.formats.toml_reading import validate_document
from twin.monitoring.step_power import SmallestStep

TITLES = {"calibrate": "Calibration", "verify": "Verification", "nightly": "Night", "try": "Trial of one ball"}
GOOD = (Decision.WITHIN, Decision.FUSED, Decision.WRITTEN, Decision.FULL_DONE)
"""Decisions of a night that leave the machine as it should be."""


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
    document, unread = _document(record, texts)
    return ReportData(
        header=_header(record, found),
        machine=as_it_is(inputs["machine"]),
        artefact=ArtefactFacts(**inputs["artefact"]),
        tool_name=as_it_is(tool),
        tool_offset=tuple(inputs["tools_mm"][tool]),
        identification=found,
        gates=_gates(record),
        warnings=(*unread, *_warnings(record, found, texts)),
        run=_facts(record, inputs, trend),
        document=document,
    )


def _document(record: RunRecord, texts: Texts) -> tuple[ReportSettings, tuple[str, ...]]:
    """Return the section `[report]` of the settings with which the run was started. Of one that this version cannot
    read, return none of its statements and a warning: the results of the run do not depend on it."""
    try:
        return validate_document(dict(record.settings.get("report", {})), "settings", ReportSettings), ()
    except TwinError as error:
        return ReportSettings(), (texts["document_unread"].format(error=error.message),)


def _header(record: RunRecord, found: IdentificationData | None) -> Header:
    settings = record.settings
    chosen = settings["identification"]
    identified = record.decision(IDENTIFIED)
    shown = {
        "Prior": prior_name(chosen, None if found is None else found.estimate),
        "Weights": "full covariances" if chosen["weights"] == "full" else "equal",
        "Touches per ball": str(_touches_per_ball(record)),
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
        verdict=_verdict(record),
        position_set=as_it_is(Path(asked_for).name) if found is None else name_of_positions(found.positions),
        settings=shown,
    )


def prior_name(identification: Mapping[str, Any], estimate: ReportedEstimate | StoredEstimate | None) -> str:
    """Return the name of the prior of an estimate. That of a night that was fused is the estimate of the nights before,
    whatever the section `identification` of the settings states."""
    if isinstance(estimate, StoredEstimate) and estimate.was_fused:
        return "earlier nights"
    return "machine family" if identification["prior"] else "none"


def _verdict(record: RunRecord) -> RunVerdict:
    figures = run_figures(record.state, record.decision)
    return figures.verdict(record.kind, record.state, ended=record.ended is not None)


def _found(record: RunRecord) -> IdentificationData | None:
    identified = record.decision(IDENTIFIED)
    if identified is None or record.estimate is None:
        return None
    observations = Observations(**identified["observations"])
    estimate = JournalEstimate(**vars(_stored(record)), unresolved_mm2=identified["unresolved_mm2"])
    return IdentificationData(
        observations=observations,
        estimate=estimate,
        acceptance=_acceptance(record, estimate, observations),
        residuals_mm=np.array(identified["residuals_mm"], dtype=np.float64),
        positions=measured_positions(record),
        volumetric=_volumetric(identified["volumetric"]),
        table=TableFacts(**identified["table"]),
        thermometer=ThermometerFacts(**identified["thermometer"]),
        travel=TravelParts.from_record(identified["travel"]),
        family_prior=_has_family_prior(record),
    )


def _acceptance(record: RunRecord, estimate: JournalEstimate, observations: Observations) -> PredictedTests | None:
    """Return the predicted figures of acceptance tests, with the table that follows from the estimate; None if the
    record of the run does not say for which tool or with which grid, as may be with one of an earlier version."""
    inputs = record.decision(INPUTS)
    try:
        settings = validate_document(dict(record.settings["table"]), "settings", TableSettings)
    except (KeyError, TwinError):
        return None
    if inputs is None:
        return None
    offset = np.array(inputs["tools_mm"][record.settings["tool"]], dtype=np.float64)
    nodes, anchor = table_grid(estimate.model, settings)
    table = build_table(estimate.model, estimate.parameters, nodes, offset, anchor, observations.axis_positions)
    return predicted_tests(estimate, table, "table of the estimate", PlaceOfTests(offset), repeats_of(record.decisions))


def _has_family_prior(record: RunRecord) -> bool:
    """Return True if the prior of the estimate was the family of the machine, and not earlier nights."""
    chosen = record.settings["identification"]
    return bool(record.kind == "calibrate" and chosen["prior"] and chosen["weights"] == "full")


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
    records = gate_records((note.record for note in record.decisions if note.kind == "gate"), record.settings)
    return tuple({one["name"]: Gate(**one) for one in records}.values())


def _facts(record: RunRecord, inputs: Mapping[str, Any], trend: str) -> RunFacts:
    outcome = record.decision(OUTCOME) or {}
    probe = record.decision(PROBE)
    touches = _touches_per_ball(record)
    return RunFacts(
        touches=outcome.get("touches", record.touches),
        machine_minutes=outcome.get("machine_minutes", record.minutes),
        forecast_minutes=outcome.get("predicted_minutes"),
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
        probe=None if probe is None else _probe(probe["facts"], outcome),
        after_homing=after_homing_text(outcome.get("after_homing")) if record.estimate is not None else "",
        touches_checked_together=None if touches >= RADIUS_PATTERN else touches,
        trend=trend,
    )


def _touches_per_ball(record: RunRecord) -> int:
    return int(record.settings["procedure"]["touches_per_ball"])


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


def _probe(facts: Mapping[str, Any], outcome: Mapping[str, Any]) -> ProbeFacts:
    homing = (outcome.get("trial") or {}).get("homing")
    rings = tuple(
        ProbeRing(ring["latitude_deg"], *(np.array(ring[name]) for name in _RING_ARRAYS)) for ring in facts["rings"]
    )
    rows = [(name, text) for name, text in facts["rows"]]
    return ProbeFacts((*rows, *(HomingScatter.from_record(homing).rows if homing else ())), rings)


_RING_ARRAYS = ("angle_deg", "residual_um", "map_angle_deg", "map_um")


def _provenance(record: RunRecord, inputs: Mapping[str, Any]) -> Provenance:
    asked = record.event("asked") or {}
    return Provenance(
        started_by=requester_of({**asked, BY: as_it_is(str(asked.get(BY, "")))}),
        files=tuple((as_it_is(file["name"]), file["sha256"]) for file in inputs["files"]),
        settings_sha256=record.settings_sha256,
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


def shown_events(record: RunRecord) -> tuple[EventLine, ...]:
    kept = [note for note in record.events if not _routine(note)]
    drifts = [note for note in record.events if _drift_um(note) is not None]
    lines = [EventLine(note.at, note.kind, _line(note)) for note in kept]
    if drifts:
        largest = max(_drift_um(note) or 0.0 for note in drifts)
        text = f"first ball measured again in {len(drifts)} positions, largest displacement {largest:.1f} µm"
        lines.append(EventLine(drifts[-1].at, "event", text))
    return tuple(sorted(lines, key=lambda line: line.timestamp))


def drifts_um(record: RunRecord) -> tuple[float, ...]:
    """Return the drift of each position in µm, in the order of measurement. The drift is the displacement of the
    position's first ball when it is measured again at the end of the position."""
    found = (_drift_um(note) for note in record.events)
    return tuple(one for one in found if one is not None)


def _routine(note: EventRow) -> bool:
    record = note.record
    drift_um = _drift_um(note)
    if drift_um is not None:
        return "note" not in record and bool(drift_um <= record["limit_um"])
    return note.kind == "asked" or str(record.get("step", "")).endswith("/found")


def _drift_um(note: EventRow) -> float | None:
    values = note.record.get("drift_um")
    return None if values is None or "limit_um" not in note.record else float(np.linalg.norm(values))


def _line(note: EventRow) -> str:
    """Return the text of an event: the name of the new state and the reason, or the record in words."""
    if note.kind == "state":
        reason = note.record.get("reason")
        state = str(note.record["state"])
        if reason and str(reason).startswith(f"{state}: "):  # the reason of an abort says so itself
            return str(reason)
        return f"{state}: {reason}" if reason else state
    by = as_it_is(str(note.record.get(BY, "")))
    return "; ".join(part for part in (record_in_words(note.record), by) if part)


def night_of(record: RunRecord) -> Mapping[str, Any] | None:
    """Return the result of a nightly run or a verification from the record of the run; None if `record` contains no
    such result."""
    outcome = record.decision(OUTCOME) or {}
    found: Mapping[str, Any] | None = outcome.get("night") or record.decision("night") or record.decision("verify")
    return found


def night_facts(record: RunRecord) -> NightFacts | None:
    night = night_of(record)
    if night is None:
        return None
    outcome = record.decision(OUTCOME) or {}
    return NightFacts(
        decision=night["decision"],
        good=night["decision"] in [decision.value for decision in GOOD],
        since=night["since"],
        rows=(*_night_rows(night), ("After a homing", after_homing_text(outcome.get("after_homing")))),
        ve_now_um=night["ve_now_um"],
        ve_before_um=night["ve_before_um"],
    )


def _found_step(step: Mapping[str, Any]) -> str:
    return f"{SmallestStep(**step).text}, with a probability of 95 %"


def _night_rows(night: Mapping[str, Any]) -> list[tuple[str, str]]:
    held_out, expected = _um(night["held_out_um"]), _um(night["held_out_predicted_um"])
    chi2 = night["chi2_normalised"]
    return [
        ("Nights since", fixed(night["nights"], 1)),
        ("Measured", f"{night['positions']} positions at station {night['station']}"),
        ("VCE after that night", _um(night["ve_before_um"])),
        ("VCE now", _um(night["ve_now_um"])),
        ("VCE with an updated table", _um(night["ve_after_um"])),
        ("Residuals of the held-out balls, rms", f"{held_out}, expected {expected}"),
        ("Consistency with the prediction", "–" if chi2 is None else f"normalised χ² {fixed(chi2, 2)}"),
        *([("Smallest detectable step of a squareness", _found_step(night["finds"]))] if night.get("finds") else []),
        ("Abrupt changes", _error_changes(night["jumped"]) or "none"),
        ("Most likely cause", _error_changes(night["likeliest"]) or "–"),
        *([("If one error changed", _possible_changes(night["alternatives"]))] if night.get("alternatives") else []),
        *([("Drift in one direction", _drift(night["drift"]))] if night.get("drift") else []),
        *([("Warning", night["warning"])] if night.get("warning") else []),
        ("Reason", night["reason"] or "none"),
    ]


def _error_changes(found: list[Mapping[str, Any]]) -> str:
    return "; ".join(f"{one['error']} {one['change']:+.1f} {one['unit']} (ln {one['evidence']:.1f})" for one in found)


def _possible_changes(found: list[Mapping[str, Any]]) -> str:
    return "; or ".join(
        f"{one['error']} {one['change']:+.1f} {one['unit']} ({100.0 * one['probability']:.0f} %)" for one in found
    )


def _drift(drift: Mapping[str, Any]) -> str:
    suspects = "; or ".join(
        f"{one['error']} {one['rate']:+.2g} ± {COVERAGE * one['standard_uncertainty']:.1g} {one['unit']} a night "
        f"({100.0 * one['probability']:.0f} %)"
        for one in drift["suspects"]
    )
    return f"for about {drift['nights']:.0f} nights: {suspects}"


def _um(value: float | None) -> str:
    return "–" if value is None else f"{fixed(value, 2)} µm"
