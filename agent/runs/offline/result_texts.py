"""Texts of the files that an identification from files writes: estimate, table, report and calibrated artefact."""

from __future__ import annotations

from dataclasses import replace
from importlib.metadata import version

import numpy as np

from agent.reports.page import Header, IdentificationData, ReportData
from agent.results.artefact_calibration import (
    calibration_texts,
    calibration_warnings,
)
from agent.results.estimation import (
    estimate_text,
    instrument_warnings,
    order_text,
    scale_warnings,
)
from agent.results.facts import ArtefactFacts, TableFacts, triple
from agent.results.gates.night_gate import night_text
from agent.results.night_changes import drift_text
from agent.runs.offline.material import IdentificationInput
from agent.runs.offline.request import IdentificationRequest
from agent.runs.offline.result import IdentificationResult
from agent.runs.result_files import ESTIMATE_FILE, REPORT
from twin.compensation.table_file import checksum, format_side_file, format_table
from twin.identification import Options
from twin.monitoring.night_fit import NightFit

TABLE_FILES = ("table.csv", "table.json")


def result_texts(result: IdentificationResult, request: IdentificationRequest) -> dict[str, str]:
    """Return the texts of the result files by file name."""
    marked = replace(result.estimation.table, gates_not_passed=result.failed)
    table = format_table(marked)
    estimate = result.estimation.estimate
    numbered = replace(estimate, rejected=result.material.balls.as_numbered(estimate.rejected))
    texts = {
        ESTIMATE_FILE: estimate_text(replace(result.estimation, estimate=numbered), _provenance(result, request)),
    }
    if request.with_report:
        from agent.reports.page.render import render_report  # noqa: PLC0415  refused input does not wait for matplotlib

        texts[REPORT] = render_report(_report_data(result, request, checksum(table) if result.has_table else ""))
    texts |= calibration_texts(
        estimate.artefact_calibration,
        result.material.artefact,
        result.run_id,
        result.timestamp,
        result.material.machine.name,
    )
    return texts | dict(zip(TABLE_FILES, (table, format_side_file(marked)), strict=True)) if result.has_table else texts


def _provenance(result: IdentificationResult, request: IdentificationRequest) -> dict[str, str]:
    return {
        "run_id": result.run_id,
        "time": result.timestamp,
        "software": f"volcal {version('volcal')}",
        "balls": request.balls.name,
        **_instruments_entry("instruments", result),
        "machine": request.machine.name,
        "artefact": request.artefact.name,
        "certificate": result.material.artefact.certificate,
        "prior": _prior_text(request, result.material.night),
        "weights": request.options.weights,
        "order": "carried over" if request.carried_over is not None else str(request.order),
        "table_tool": result.material.tool,
        **request.provenance,
    }


def _instruments_entry(key: str, result: IdentificationResult) -> dict[str, str]:
    """Return an entry with the names of the instruments, and which of them were not used; none without instruments."""
    checks = result.estimation.estimate.instruments
    names = ", ".join(check.name if check.joined else f"{check.name} (not used)" for check in checks)
    return {key: names} if checks else {}


def _prior_text(request: IdentificationRequest, night: NightFit | None) -> str:
    if request.carried_over is not None and night is not None:
        learned = f", times {night.factor:.2g} as learned" if request.process_noise_um > 0.0 else ""
        return f"{request.carried_over.name}, changed since by {request.process_noise_um:g} µm rms{learned}"
    return "family of the machine" if request.options.use_prior else "none"


def _report_data(result: IdentificationResult, request: IdentificationRequest, crc32: str) -> ReportData:
    material, estimation, options = result.material, result.estimation, request.options
    settings = {
        "Prior": _prior_text(request, material.night),
        "Weights": "full covariances" if options.weights == "full" else "all alike",
        "Legendre order": order_text(estimation.estimate),
        "Ball centres from": request.balls.name,
        **_instruments_entry("Instruments", result),
    }
    header = Header(
        title="Identification from files",
        run_id=result.run_id,
        timestamp=result.timestamp,
        software_version=version("volcal"),
        state="complete" if result.has_table else "refused",
        position_set=result.position_set,
        settings=settings,
    )
    return ReportData(
        header=header,
        machine=material.machine.name,
        artefact=ArtefactFacts.of(material.artefact),
        tool_name=material.tool,
        tool_offset=triple(material.machine.tool(material.tool)),
        identification=IdentificationData.of(
            material.balls.observations,
            estimation.estimate,
            material.balls.positions,
            estimation.volumetric,
            TableFacts.of(estimation.table, crc32) if result.has_table else None,
            estimation.thermometer,
            estimation.travel,
            material.balls.numbers,
            family_prior=options.use_prior and options.weights == "full" and request.carried_over is None,
        ),
        gates=result.gates,
        warnings=(*_gate_notes(result), *_warnings(result, options)),
    )


def _gate_notes(result: IdentificationResult) -> tuple[str, ...]:
    """Return one sentence for each gate that did not pass: with a table, that it was written all the same."""
    begin = "Written although" if result.has_table else "No table was written:"
    return tuple(
        f"{begin} the gate {gate.name} failed: {gate.figures}; {gate.text}." for gate in result.gates if not gate.passed
    )


def _warnings(result: IdentificationResult, options: Options) -> tuple[str, ...]:
    """Return the warnings that a person should read before loading the table into a machine."""
    material, estimation = result.material, result.estimation
    notes = ["Nothing was measured with the table active: values after compensation are predictions."]
    share = float(np.mean(estimation.table.extrapolated))
    if share > 0.0:
        notes.append(f"{100.0 * share:.0f} % of the table's nodes lie outside the measured region.")
    if material.tool not in _used_tools(material):
        notes.append(f"The table is made for the tool {material.tool}, but nothing was measured with this tool.")
    if estimation.thermometer.warning is not None:
        notes.append(estimation.thermometer.warning)
    if material.night is not None and not material.night.fits:
        notes.append(f"{_sentence(night_text(material.night))}.")
    if material.night is not None and material.night.drift is not None:
        notes.append(f"{_sentence(drift_text(material.night.drift))}.")
    if not options.use_prior:
        notes.append("Without the family, unseen directions count as zero: the stated uncertainties leave them out.")
    notes += instrument_warnings(estimation.estimate)
    calibration = estimation.estimate.artefact_calibration
    return (*notes, *calibration_warnings(calibration), *scale_warnings(estimation.estimate))


def _sentence(text: str) -> str:
    return text[0].upper() + text[1:]


def _used_tools(material: IdentificationInput) -> set[str]:
    names = list(material.machine.tools)
    return {names[tool] for tool in np.unique(material.balls.observations.tool)}
