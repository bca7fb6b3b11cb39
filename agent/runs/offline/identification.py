"""Identification without a machine. It reads ball centres from files and writes an estimate, a table and a report."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from agent.files import check_folder, read_text, translated, write_all_atomically
from agent.reports.page import name_of_positions
from agent.results.artefact_calibration import (
    CALIBRATION_FILES,
)
from agent.results.estimation import (
    EstimationResult,
    estimate_with_table,
)
from agent.results.gates.estimate_gates import estimate_gates
from agent.results.gates.gate import Gate
from agent.results.gates.night_gate import night_gate
from agent.results.gates.table_gates import gain_gate, table_gates
from agent.results.table_replacement import ExpectedGain
from agent.runs.offline.material import IdentificationInput, read_material
from agent.runs.offline.request import IdentificationRequest
from agent.runs.offline.result import IdentificationResult
from agent.runs.offline.result_texts import TABLE_FILES, result_texts
from agent.runs.result_files import IDENTIFY, REPORT, check_inputs_kept, replaced_results
from drivers.roles import Activation, StoreLimits
from twin.errors import DataError
from twin.formats.toml_reading import parse_toml
from twin.units import UM_PER_MM

NO_STORE = StoreLimits((), (0, 0, 0), 0, 0.0, float("inf"), Activation.IMMEDIATE)
"""Limits that never apply, for a table that is written to a file only."""


MAX_NOISE_FACTOR = 5.0
"""Largest ratio, and the inverse of the smallest one, of the noise in the residuals to the stated uncertainty."""


def identify_files(request: IdentificationRequest, timestamp: str) -> IdentificationResult:
    """Identify the machine's errors from files, and write the results into the folder `request.out`.

    The files written are estimate.json, report.html if `request.with_report` is True, and table.csv and table.json if
    every gate passed or `request.even_so` is True. If the artefact was calibrated, its artefact file and covariance are
    written as well. If this identification writes no table, a table in the folder is deleted; so are the other files
    of these that an earlier identification wrote (see `replaced_results`), because they do not belong to the new
    estimate. `timestamp` is the UTC time of the results in ISO 8601. Raises UserError if the input is wrong or if a
    result would replace or delete a file of the input; in these cases, no file is written.
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
    texts = result_texts(result, request)
    inputs = (request.balls, request.machine, request.artefact)
    # Whoever wrote a table: beside an estimate that permits none, it would be taken for the table of this estimate.
    former = (*TABLE_FILES, *replaced_results(request.out, (REPORT, *CALIBRATION_FILES), inputs))
    check_inputs_kept(request.out, (*texts, *former), _files_read(request))
    write_all_atomically(request.out, texts, (name for name in former if name not in texts))
    return result


def _files_read(request: IdentificationRequest) -> Iterator[Path]:
    yield from (request.balls, request.machine, request.artefact, *request.instruments)
    if request.carried_over is not None:
        yield request.carried_over
    covariance = parse_toml(read_text(request.artefact), str(request.artefact)).get("covariance_file")
    if covariance is not None:
        yield request.artefact.parent / str(covariance)


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
