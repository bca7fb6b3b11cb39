"""Identification without a machine. It reads ball centres from files and writes an estimate, a table and a report."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from agent.files import check_folder, read_text, translated, write_all_atomically
from agent.model_files import load_artefact, load_balls, load_instruments, load_machine
from agent.reports.page import Header, IdentificationData, ReportData, name_of_positions
from agent.results.artefact_calibration import (
    CALIBRATION_FILES,
    calibration_texts,
    calibration_warnings,
)
from agent.results.estimation import (
    EstimationResult,
    estimate_text,
    estimate_with_table,
    instrument_warnings,
    order_text,
    scale_warnings,
)
from agent.results.facts import ArtefactFacts, TableFacts, triple
from agent.results.gates import (
    Gate,
    estimate_gates,
    gain_gate,
    names_of_failed,
    reasons,
    require_passed,
    table_gates,
)
from agent.results.night_changes import drift_text
from agent.results.night_gate import night_document, night_gate, night_text
from agent.results.table_replacement import ExpectedGain
from agent.runs.result_files import ESTIMATE_FILE, IDENTIFY, REPORT, replaced_results
from agent.settings.schema import GateSettings, Order, TableSettings, VerificationSettings
from agent.thermal.thermometer import ThermometerStatement
from drivers.errors import ConfigurationError, InputError
from drivers.roles import Activation, StoreLimits
from twin.artefact.artefact import Artefact
from twin.compensation.table_file import checksum, format_side_file, format_table
from twin.errors import DataError
from twin.formats.ball_file import BallFile
from twin.formats.estimate_file import certificate_document, parse_estimate
from twin.identification import Options, process_noise
from twin.identification.checks.measured_shape import check_shape
from twin.identification.identify import accepted_rows
from twin.identification.order import ORDERS
from twin.machine.error_model import ErrorModel
from twin.machine.machine_description import MachineDescription
from twin.monitoring.night_fit import NightFit, compare_with_nights_before
from twin.units import MM_PER_UM, UM_PER_MM

NO_STORE = StoreLimits((), (0, 0, 0), 0, 0.0, float("inf"), Activation.IMMEDIATE)
"""Limits that never apply, for a table that is written to a file only."""

TABLE_FILES = ("table.csv", "table.json")

DEFAULT_GATES = GateSettings()
"""Limits if no settings file states any."""

DEFAULT_MIN_GAIN = VerificationSettings().min_gain
"""Smallest relative decrease of the VE by a table if no settings file states it."""

DEFAULT_TABLE = TableSettings()
"""Grid and anchor of the table if no settings file states them."""

MAX_NOISE_FACTOR = 5.0
"""Largest ratio, and the inverse of the smallest one, of the noise in the residuals to the stated uncertainty."""


@dataclass(frozen=True)
class IdentificationRequest:
    """Files and options of an identification of a machine's errors from files.

    `tool` is the tool for which the compensation table is made; if it is None, the tool with which most balls were
    measured is used. `carried_over` is the file of an earlier estimate that serves as prior. `process_noise_um` is the
    possible change of the machine's error field since that estimate. It is an rms over the workspace in µm, after
    removal of the best-fitting rigid motion. `gates` contains the limits (gates) that the estimate and the table
    must meet, and `min_gain` the smallest relative decrease of the VE that is expected with the table; or no table is
    written. `table` sets the grid and the anchor of the table. If `even_so` is True, the
    table is written in any case; it then carries a mark. `temperature_uncertainty_k` is the standard uncertainty of the
    artefact's temperature in K, common to all rows; it is None if it is not stated. In this case
    `thermometer_uncertainty_k`, the uncertainty of the thermometer according to the settings, is used for a ball file
    that contains temperatures. `instruments` are files with readings of other instruments; those that contradict are
    used only if `join_contradicting` is True. If `with_report` is False, no report is drawn, which takes as long as the
    identification.
    """

    balls: Path
    machine: Path
    artefact: Path
    out: Path
    options: Options
    tool: str | None = None
    order: Order = "evidence"
    carried_over: Path | None = None
    process_noise_um: float = 0.0
    gates: GateSettings = DEFAULT_GATES
    min_gain: float = DEFAULT_MIN_GAIN
    table: TableSettings = DEFAULT_TABLE
    even_so: bool = False
    temperature_uncertainty_k: float | None = None
    thermometer_uncertainty_k: float | None = None
    instruments: tuple[Path, ...] = ()
    join_contradicting: bool = False
    with_report: bool = True


@dataclass(frozen=True)
class IdentificationInput:
    """Contents of the input files of an identification: machine, artefact, measured balls and options. `tool` is the
    tool for which the compensation table is made, and `thermometer` the uncertainty of the artefact's temperature.
    `night` compares the balls with the carried-over estimate; it is None without one."""

    machine: MachineDescription
    artefact: Artefact
    balls: BallFile
    tool: str
    options: Options
    thermometer: ThermometerStatement
    night: NightFit | None = None


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


def identify_files(request: IdentificationRequest, timestamp: str) -> IdentificationResult:
    """Identify the machine's errors from files, and write the results into the folder `request.out`.

    The files written are estimate.json, report.html if `request.with_report` is True, and table.csv and table.json if
    every gate passed or `request.even_so` is True. If the artefact was calibrated, its artefact file and covariance are
    written as well. If this identification writes no table, a table in the folder is deleted; so are the other files
    of these that an earlier identification wrote (see `replaced_results`), because they do not belong to the new
    estimate. `timestamp` is the UTC time of the results in ISO 8601. Raises UserError if the input is wrong; in this
    case, no file is written.
    """
    check_folder(request.out)
    material = read_material(request)
    with translated(file=str(request.balls)):
        estimation, gates = _gated(material, request)
    result = IdentificationResult(
        run_id=f"{IDENTIFY}{timestamp[:19].replace('-', '').replace(':', '')}Z",
        timestamp=timestamp,
        position_set=name_of_positions(material.balls.positions),
        material=material,
        estimation=estimation,
        gates=gates,
        table_file=request.out / TABLE_FILES[0],
        report=request.out / REPORT if request.with_report else None,
        even_so=request.even_so,
    )
    texts = _texts(result, request)
    inputs = (request.balls, request.machine, request.artefact)
    # Whoever wrote a table: beside an estimate that permits none, it would be taken for the table of this estimate.
    former = (*TABLE_FILES, *replaced_results(request.out, (REPORT, *CALIBRATION_FILES), inputs))
    write_all_atomically(request.out, texts, (name for name in former if name not in texts))
    return result


def read_material(request: IdentificationRequest) -> IdentificationInput:
    """Return the contents of the input files of an identification.

    Raises UserError if a part of a file cannot be used. The message names the file and the key or the row.
    """
    machine = load_machine(request.machine)
    artefact = load_artefact(request.artefact)
    balls = load_balls(request.balls, machine)
    if not machine.family.half_widths.any():
        hint = "enter the half-widths of machines of this kind"
        message = "every half-width of the family is zero, so there is nothing to identify"
        raise ConfigurationError(message, hint=hint, file=str(request.machine), key="model.family")
    tool = _table_tool(request, machine, balls)
    thermometer = _thermometer(request, balls)
    options = replace(request.options, temperature_standard_uncertainty_k=thermometer.standard_uncertainty_k)
    material = IdentificationInput(machine, artefact, balls, tool, options, thermometer)
    if request.carried_over is not None:
        material = _after_earlier_night(material, request, request.carried_over)
    return _with_instruments(material, request) if request.instruments else material


def _with_instruments(material: IdentificationInput, request: IdentificationRequest) -> IdentificationInput:
    """Return `material` with the readings of other instruments among its options. Values of an earlier report must be
    those of parameters that every order which may be chosen has."""
    machine, options = material.machine, material.options
    if options.carried_over is not None:
        model = options.carried_over.unknowns.model
    elif request.order == "file":
        model = machine.model
    else:
        model = machine.with_order(ORDERS[0] if request.order == "evidence" else request.order).model
    readings = load_instruments(request.instruments, machine, model)
    with translated(ConfigurationError):
        joined = replace(options, instruments=readings, join_contradicting=request.join_contradicting)
    return replace(material, options=joined)


def _thermometer(request: IdentificationRequest, balls: BallFile) -> ThermometerStatement:
    """Return the uncertainty of the artefact's temperature. The settings describe a thermometer, so they do not apply
    to a file without temperatures."""
    stated_k = request.temperature_uncertainty_k
    if stated_k is None and balls.temperature_was_read:
        stated_k = request.thermometer_uncertainty_k
    return ThermometerStatement.of(stated_k, balls.temperature_was_read)


def _after_earlier_night(
    material: IdentificationInput, request: IdentificationRequest, path: Path
) -> IdentificationInput:
    """Return `material` with the earlier estimate in `path` as prior, widened by the change since that estimate, and
    with the comparison of the balls with that estimate.

    Balls that contradict the others of the same night are left out of the comparison.
    """
    machine, artefact, options, balls = material.machine, material.artefact, material.options, material.balls
    seen = balls.observations
    text = read_text(path)
    with translated(InputError, file=str(path)):
        known = parse_estimate(text, str(path)).carried_over()
        _check_same_beams(machine.model, known.unknowns.model, str(request.machine))
        family = machine.with_model(known.unknowns.model).family
        noise = process_noise(family, MM_PER_UM * request.process_noise_um, machine.tool(material.tool))
    known = known if balls.temperature_was_read else known.for_another_thermometer()
    with translated(ConfigurationError):
        replace(options, carried_over=known)  # refuses options that do not go with an earlier estimate
    with translated(file=str(request.balls)), balls.places_named():
        check_shape(seen, artefact)
        night = compare_with_nights_before(
            family,
            seen.select(accepted_rows(family, seen, artefact, options).mask),
            artefact,
            known,
            noise,
            options=options,
            night_false_alarm=request.gates.night_false_alarm,
        )
    return replace(material, options=replace(options, carried_over=night.prior), night=night)


def _check_same_beams(nominal: ErrorModel, earlier: ErrorModel, machine: str) -> None:
    """Raise DataError if the cross-effect or the beams of the machine file are not those of the earlier estimate, whose
    model would replace them."""
    if (nominal.cross_effect, nominal.structure) != (earlier.cross_effect, earlier.structure):
        raise DataError(
            f"the cross-effect or the beams of the machine in {machine} have been changed since this estimate",
            hint="identify without --carried-over once, or use the machine file of that estimate",
        )


def _gated(material: IdentificationInput, request: IdentificationRequest) -> tuple[EstimationResult, tuple[Gate, ...]]:
    """Return the estimate with its table, and the gates that a run has to pass too. Raises TwinError."""
    with material.balls.places_named():
        estimation = estimate_with_table(
            material.machine,
            material.artefact,
            material.tool,
            material.balls.observations,
            material.options,
            material.thermometer,
            request.table,
            request.order,
        )
    if material.balls.numbers:
        estimation = estimation.with_numbers(material.balls.numbers)
    _check_stated_noise(estimation, material)
    left_um = estimation.volumetric.after_aligned.value_um
    gain = ExpectedGain(math.hypot(estimation.volumetric.table_ve_um, left_um), left_um)
    gates = (
        *estimate_gates(estimation.estimate, request.gates),
        gain_gate(gain, request.min_gain),
        *table_gates(estimation.table, estimation.travel, NO_STORE, request.gates),
        *(() if material.night is None else (night_gate(material.night, request.gates),)),
    )
    return estimation, gates


def _check_stated_noise(estimation: EstimationResult, material: IdentificationInput) -> None:
    """Raise DataError if the residuals contradict the standard uncertainties of the ball file by more than the factor
    `MAX_NOISE_FACTOR`. The weights of an identification with equal weights do not depend on them."""
    if material.options.weights != "full":
        return
    factor = math.sqrt(estimation.estimate.chi2_normalised)
    if 1.0 / MAX_NOISE_FACTOR <= factor <= MAX_NOISE_FACTOR:
        return
    variance = material.balls.observations.coordinate_variances_mm2
    stated_um = UM_PER_MM * float(np.sqrt(np.median(variance)))
    first, last = min(material.balls.rows), max(material.balls.rows)
    raise DataError(
        f"the ball centres repeat to {factor * stated_um:.2g} µm, but rows {first} to {last} state {stated_um:.2g} µm",
        column="sigma_um",
        hint="give the standard uncertainty in µm; if it is right, look for the cause of the residuals",
    )


def _table_tool(request: IdentificationRequest, machine: MachineDescription, balls: BallFile) -> str:
    names = list(machine.tools)
    if request.tool is None:
        return names[int(np.bincount(balls.observations.tool).argmax())]
    if request.tool not in names:
        hint = f"Known tools: {', '.join(names)}"
        raise ConfigurationError(f"the machine has no tool '{request.tool}'", hint=hint, file=str(request.machine))
    return request.tool


def _texts(result: IdentificationResult, request: IdentificationRequest) -> dict[str, str]:
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
