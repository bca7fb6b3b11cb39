"""Estimate file (JSON): parameters of the error model by ISO 230-1 name with their covariance, the parameter
combinations that were not determined, and the provenance of the estimate.

The file also contains everything that is needed to use the estimate as the prior of the next estimate.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from twin.arrays import Array
from twin.artefact.artefact_calibration import COVERAGE_FACTOR, ArtefactCalibration
from twin.artefact.certificate import BallDistance
from twin.display import Displayed
from twin.errors import FormatError, TwinError
from twin.formats.drift_section import read_trend
from twin.formats.estimate_sections import EstimateFile, Triple, VolumetricSection
from twin.formats.instrument_section import instrument_documents
from twin.formats.json_reading import read_json
from twin.formats.prior_section import KEY, carried_over_document, read_moments, read_unknowns
from twin.identification import (
    BallCheck,
    CarriedOverPrior,
    CommonScale,
    DriftFactor,
    Estimate,
    EstimatedShift,
    Misfit,
    PatternTest,
    StepInRun,
)
from twin.identification.drift_trend import DriftTrend
from twin.identification.instruments.check_result import InstrumentCheck
from twin.identification.unknowns import Unknowns
from twin.machine.axis_polynomial import AxisPolynomial
from twin.machine.cross_term import CrossTerm
from twin.machine.error_model import ErrorModel
from twin.machine.kinematic_chain import parse_chain
from twin.units import MM_PER_UM, UM_PER_MM

FORMAT = "volcal estimate 3"
_REMEDY = "Identify again from the balls.csv of that run (volcal identify), or calibrate the machine again"
_ASYMMETRY = 1e-9
_INDEFINITE = 1e-6


@dataclass(frozen=True, eq=False)
class StoredEstimate(Displayed):
    """Estimate of the errors of a machine as stored in a file. Its content is sufficient for building a compensation
    table, for comparing estimates, and for use as the prior of the next estimate. `document` is the content of the
    file."""

    model: ErrorModel
    parameters: Array
    covariance: Array
    tool_offsets: Array
    unknowns: Unknowns
    z: Array
    z_covariance: Array
    trend: DriftTrend
    document: EstimateFile

    def __repr__(self) -> str:
        return f"<StoredEstimate: {len(self.parameters)} parameters>"

    @property
    def misfit(self) -> Misfit | None:
        """Estimated part of the error field that the error model cannot represent; None if it was not estimated."""
        unresolved_mm2 = self.unknowns.unresolved_mm2(self.document.scales.scales)
        return Misfit.of(self.unknowns, self.z, self.z_covariance, unresolved_mm2)

    @property
    def scatter_mm2(self) -> float:
        """Variance in mm² per direction by which the ball centres scatter beyond their stated noise."""
        return self.unknowns.scatter_mm2(self.document.scales.scales)

    @property
    def certificate_check(self) -> tuple[BallCheck, ...]:
        """Comparison of each certified ball centre with the measurements."""
        return tuple(
            BallCheck(row.ball, row.contradiction, _millimetres(row.apparent_error_um), row.certified)
            for row in self.document.certificate
        )

    @property
    def instruments(self) -> tuple[InstrumentCheck, ...]:
        """Tests of the other instruments, and whether their readings are part of the estimate."""
        return tuple(section.check for section in self.document.instruments)

    @property
    def artefact_calibration(self) -> ArtefactCalibration | None:
        """Ball centres of the artefact as estimated from the measurements; None if they were not estimated."""
        return self.unknowns.artefact_calibration(self.z, self.z_covariance)

    @property
    def drift_factor(self) -> DriftFactor:
        """Factor on the process noise between nights, as learned until this estimate."""
        return DriftFactor(**self.document.carried_over.drift_factor.model_dump())

    @property
    def was_fused(self) -> bool:
        """True if the prior of this estimate was that of an earlier night: only such an estimate knows of a drift."""
        return bool(self.trend) or self.drift_factor != DriftFactor()

    def carried_over(self) -> CarriedOverPrior:
        """Return this estimate as the prior of a later estimate, without process noise: the machine is assumed not to
        have changed in between. Raise DataError if the covariance is singular."""
        scales = self.document.scales.scales
        factor = self.drift_factor
        freedom = self.document.degrees_of_freedom
        joined = self.document.carried_over.joined_readings
        return CarriedOverPrior(self.unknowns, self.z, self.z_covariance, scales, factor, freedom, self.trend, joined)


def format_estimate(
    estimate: Estimate, provenance: Mapping[str, str], volumetric: VolumetricSection | None = None
) -> str:
    """Return the text (JSON) of an estimate file.

    `provenance` contains the software version, the time, and the names and checksums of the input files. All entries of
    `provenance` are stored unchanged. `volumetric` contains the volumetric errors for the tool of the table; the file
    has null in its place if it is None.
    """
    document: dict[str, Any] = {
        "format": FORMAT,
        "provenance": dict(provenance),
        "formulation": estimate.formulation,
        "model": _model_document(estimate.model),
        "tool_offsets_mm": estimate.tool_offsets.tolist(),
        "parameters": _parameters(estimate),
        "covariance": estimate.covariance.tolist(),
        "rank": estimate.rank,
        "conditioning": estimate.conditioning,
        "null_summary": list(estimate.null_summary),
        "null_directions": [
            {"text": null.text, "changes_field": null.changes_field, "loadings": dict(null.loadings)}
            for null in estimate.null_directions
        ],
        "chi2_normalised": estimate.chi2_normalised,
        "degrees_of_freedom": estimate.degrees_of_freedom,
        "scales": vars(estimate.scales),
        "scales_at_bounds": list(estimate.scales_at_bounds),
        "order_evidence": [
            {
                "order": entry.order,
                "relative_log_evidence": entry.relative_log,
                "chosen": entry.chosen,
                "scales": vars(entry.scales),
            }
            for entry in estimate.order_evidence
        ],
        "rejected": [{"position": k, "ball": ball, "tool": tool} for k, ball, tool in estimate.rejected],
        "certificate": certificate_document(estimate.certificate_check),
        "step_in_run": step_document(estimate.step),
        "shift_pattern": pattern_document(estimate.pattern),
        "ball_shifts": ball_shift_documents(estimate.shifts),
        "common_scale": common_scale_document(estimate.common_scale),
        # A resumed run compares this document with the one that an earlier version may have stored without these keys.
        **({"instruments": instrument_documents(estimate.instruments)} if estimate.instruments else {}),
        "artefact_calibration": calibration_document(estimate.artefact_calibration),
        "volumetric": None if volumetric is None else volumetric.model_dump(),
        "carried_over": {
            **carried_over_document(
                estimate.unknowns, estimate.z, estimate.z_covariance, estimate.drift_factor, estimate.trend
            ),
            **({"joined_readings": list(estimate.joined_readings)} if estimate.joined_readings else {}),
        },
    }
    return _text(document) + "\n"


def certificate_document(checks: Sequence[BallCheck]) -> list[dict[str, Any]]:
    """Return the checks of the certified ball centres as JSON objects, one for each ball."""
    return [
        {
            "ball": check.ball,
            "certified": check.certified,
            "contradiction": check.contradiction,
            "direction": check.direction,
            "apparent_error_um": [UM_PER_MM * value for value in check.apparent_error_mm],
        }
        for check in checks
    ]


def step_document(step: StepInRun | None) -> dict[str, Any] | None:
    """Return the result of the test for a sudden change of the machine as a JSON object, or None if the measurements
    were not tested."""
    if step is None:
        return None
    return {
        "false_alarm": step.false_alarm,
        "suspects": [
            {
                "error": one.jump.error,
                "change": one.jump.change,
                "unit": one.jump.unit,
                "probability": one.probability,
                "last_before": list(one.last_before),
                "first_after": list(one.first_after),
            }
            for one in step.suspects
        ],
        "hidden": None if step.hidden is None else asdict(step.hidden),
    }


def pattern_document(pattern: PatternTest | None) -> dict[str, Any] | None:
    """Return the result of the test for a pattern of shifts as a JSON object, or None if the measurements were not
    tested."""
    if pattern is None:
        return None
    suspects = [{"text": one.text, "size_um": one.size_um, "probability": one.probability} for one in pattern.suspects]
    return {"false_alarm": pattern.false_alarm, "suspects": suspects}


def ball_shift_documents(shifts: Sequence[EstimatedShift]) -> list[dict[str, Any]]:
    """Return the shifts of the balls that were estimated as JSON objects, one for each shift."""
    return [asdict(shift) for shift in shifts]


def common_scale_document(scale: CommonScale | None) -> dict[str, Any] | None:
    """Return the result of the test of the common scale of all axes as a JSON object, or None if it was not tested."""
    return None if scale is None else {**asdict(scale), "axes_um_per_m": list(scale.axes_um_per_m)}


def calibration_document(calibration: ArtefactCalibration | None) -> dict[str, Any] | None:
    """Return the calibration of the artefact as a JSON object, or None if there is none."""
    if calibration is None:
        return None
    return {
        "balls_mm": calibration.balls.tolist(),
        "expanded_uncertainty_um": (UM_PER_MM * calibration.expanded_uncertainty_mm).tolist(),
        "coverage_factor": COVERAGE_FACTOR,
        "covariance_um2": (UM_PER_MM**2 * calibration.covariance).tolist(),
        "scale": _length_document(calibration.scale),
        "scale_before": _length_document(calibration.before),
        "certified_before": calibration.certified,
        "not_improved": list(calibration.not_improved),
        "limits": list(calibration.limits),
    }


def _length_document(length: BallDistance) -> dict[str, Any]:
    return {
        "balls": list(length.balls),
        "length_mm": length.length_mm,
        "standard_uncertainty_um": UM_PER_MM * length.standard_uncertainty_mm,
    }


def _text(value: object) -> str:
    """Return `value` as JSON text. Each entry of an object stands on its own line. Each entry of a list also stands on
    its own line if the list contains lists or objects."""
    if isinstance(value, dict):
        lines = ",\n".join(f"{json.dumps(key)}: {_text(entry)}" for key, entry in value.items())
        return f"{{\n{lines}\n}}"
    if isinstance(value, list) and value and isinstance(value[0], list | dict):
        lines = ",\n".join(json.dumps(entry, allow_nan=False) for entry in value)
        return f"[\n{lines}\n]"
    return json.dumps(value, allow_nan=False)


def parse_estimate(text: str, source: str) -> StoredEstimate:
    """Return the stored estimate given as JSON text. Raise FormatError, which names `source` and the key, if the text
    is invalid or has a different format."""
    document = read_json(text, source, EstimateFile, format_name=FORMAT, remedy=_REMEDY)
    try:
        chain = parse_chain(document.model.chain)
        cross = document.model.cross_effect
        structure = tuple(
            CrossTerm(one.name, one.error, AxisPolynomial.of(one.polynomial)) for one in document.model.structure
        )
        model = ErrorModel(chain, document.model.ranges_mm, document.model.orders, cross, structure)
    except TwinError as error:
        raise FormatError(error.message, hint=error.hint, file=source, key="model") from None
    _check_names(document, model, source)
    unknowns = read_unknowns(document.carried_over, model, source)
    z, z_covariance = read_moments(document.carried_over, unknowns.blocks.size, source)
    trend = read_trend(document.carried_over.trend, unknowns, source, f"{KEY}.trend")
    return StoredEstimate(
        model=model,
        parameters=np.array([parameter.value for parameter in document.parameters]),
        covariance=_covariance(document, source),
        tool_offsets=np.array(document.tool_offsets_mm, dtype=np.float64),
        unknowns=unknowns,
        z=z,
        z_covariance=z_covariance,
        trend=trend,
        document=document,
    )


def _millimetres(values_um: Triple) -> Triple:
    x, y, z = (MM_PER_UM * value for value in values_um)
    return (x, y, z)


def _model_document(model: ErrorModel) -> dict[str, Any]:
    return {
        "chain": str(model.chain),
        "ranges_mm": [list(pair) for pair in model.ranges_mm],
        "orders": dict(model.orders),
        "cross_effect": list(model.cross_effect),
        **({"structure": _structure_document(model.structure)} if model.structure else {}),
    }


def _structure_document(structure: Sequence[CrossTerm]) -> list[dict[str, Any]]:
    return [
        {"name": one.name, "error": one.error, "polynomial": [list(part) for part in one.polynomial.terms]}
        for one in structure
    ]


def _parameters(estimate: Estimate) -> list[dict[str, Any]]:
    known = zip(estimate.model.parameters, estimate.parameters.tolist(), strict=True)
    return [
        {"name": parameter.name, "value": value, "standard_uncertainty": sigma, "unit": parameter.unit}
        for (parameter, value), sigma in zip(known, estimate.standard_uncertainty.tolist(), strict=True)
    ]


def _check_names(document: EstimateFile, model: ErrorModel, source: str) -> None:
    found = [parameter.name for parameter in document.parameters]
    if len(found) != model.size:
        message = f"{len(found)} parameters, but the model has {model.size}"
        raise FormatError(message, file=source, key="parameters")
    for index, (name, parameter) in enumerate(zip(found, model.parameters, strict=True)):
        if name != parameter.name:
            message = f"parameter '{name}' instead of '{parameter.name}'"
            raise FormatError(message, file=source, key=f"parameters[{index}].name")
        if document.parameters[index].unit != parameter.unit:
            message = f"the unit of {name} must be {parameter.unit}"
            raise FormatError(message, file=source, key=f"parameters[{index}].unit")


def _covariance(document: EstimateFile, source: str) -> Array:
    size = len(document.parameters)
    if len(document.covariance) != size or any(len(row) != size for row in document.covariance):
        raise FormatError(f"the covariance must have {size} rows of {size} numbers", file=source, key="covariance")
    covariance = np.array(document.covariance)
    scale = np.sqrt(np.maximum(np.diagonal(covariance), 0.0))
    scale = np.where(scale > 0.0, scale, 1.0)
    with np.errstate(over="ignore", divide="ignore", invalid="ignore"):
        unit = covariance / scale[:, None] / scale
        # a covariance that is far too large for its variances makes `unit` infinite, the difference NaN
        asymmetry = np.abs(unit - unit.T).max()
    if asymmetry > _ASYMMETRY:
        raise FormatError("the covariance is not symmetric", file=source, key="covariance")
    if not np.isfinite(unit).all() or np.linalg.eigvalsh(unit)[0] < -_INDEFINITE:
        raise FormatError("the covariance is not positive semi-definite", file=source, key="covariance")
    return covariance
