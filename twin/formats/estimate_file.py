"""Estimate file (JSON): parameters of the error model by ISO 230-1 name with their covariance, the parameter
combinations that were not determined, and the provenance of the estimate.

The file also contains everything that is needed to use the estimate as the prior of the next estimate.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import AfterValidator, Field, model_validator

from twin.arrays import Array
from twin.artefact.artefact_calibration import COVERAGE_FACTOR, ArtefactCalibration
from twin.artefact.certificate import BallDistance
from twin.display import Displayed
from twin.errors import FormatError, TwinError
from twin.formats.drift_section import read_trend
from twin.formats.instrument_section import InstrumentSection, instrument_documents
from twin.formats.json_reading import read_json
from twin.formats.prior_section import KEY, CarriedOverSection, carried_over_document, read_moments, read_unknowns
from twin.formats.toml_reading import StrictModel
from twin.identification import (
    BallCheck,
    CarriedOverPrior,
    CommonScale,
    DriftFactor,
    Estimate,
    EstimatedShift,
    Misfit,
    PatternTest,
    Scales,
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
_ROUNDING = 1e-12


def _without_rounding(probability: float) -> float:
    """Return 1 for a sum of probabilities that exceeds 1 by its rounding, as earlier versions have stored it."""
    return 1.0 if 1.0 < probability <= 1.0 + _ROUNDING else probability


Probability = Annotated[float, AfterValidator(_without_rounding), Field(ge=0.0, le=1.0 + _ROUNDING)]

Pair = tuple[float, float]
Power = Annotated[int, Field(ge=0, le=20)]
Triple = tuple[float, float, float]


class CrossTermSection(StrictModel):
    """Term of the cross-effect of a beam in an estimate file. `polynomial` contains the powers of x, y and z, as
    fractions of the axis ranges, and a coefficient."""

    name: str
    error: str
    polynomial: tuple[tuple[tuple[Power, Power, Power], float], ...]


class EstimatedModelSection(StrictModel):
    chain: str
    ranges_mm: tuple[Pair, Pair, Pair]
    orders: dict[str, int]
    cross_effect: tuple[str, ...]
    structure: tuple[CrossTermSection, ...] = ()


class ParameterSection(StrictModel):
    """One parameter in an estimate file. `value` and `standard_uncertainty` are stated in `unit`.

    Legendre coefficients refer to the axis range normalised to [-1, 1].
    """

    name: str
    value: float
    standard_uncertainty: float = Field(ge=0.0)
    unit: Literal["mm", "rad"]


class NullDirectionSection(StrictModel):
    text: str
    changes_field: bool
    loadings: dict[str, float]


class ScalesSection(StrictModel):
    noise: float
    prior: float
    mixed: float
    waves_x: float
    waves_y: float
    waves_z: float
    stationary_x: float
    stationary_y: float
    stationary_z: float
    independent_x: float
    independent_y: float
    independent_z: float

    @model_validator(mode="before")
    @classmethod
    def _earlier_form(cls, given: Any) -> Any:
        """Accept files in which each part of the error motions has one scale for all axes."""
        if not isinstance(given, dict):
            return given
        parts = {name: value for name, value in given.items() if name in ("stationary", "independent")}
        rest = {name: value for name, value in given.items() if name not in parts}
        return rest | {f"{name}_{axis}": value for name, value in parts.items() for axis in "xyz"}

    @property
    def scales(self) -> Scales:
        return Scales(**self.model_dump())


class RejectedBallSection(StrictModel):
    position: int
    ball: int
    tool: int


class OrderSection(StrictModel):
    """Evidence (marginal likelihood) of one Legendre order of the error model, as stored in an estimate file.
    `relative_log_evidence` is the log evidence of this order minus the log evidence of the likeliest order that was
    compared."""

    order: int
    relative_log_evidence: float
    chosen: bool
    scales: ScalesSection


class CertificateSection(StrictModel):
    """Comparison of one certified ball centre with the measurements.

    `contradiction` is in standard deviations along the worst direction, and `direction` is the axis of the artefact's
    frame nearest to the apparent error `apparent_error_um`. `certified` is False for a ball that the artefact file
    declares as uncertified.
    """

    ball: int
    certified: bool
    contradiction: float = Field(ge=0.0)
    direction: Literal["X", "Y", "Z"]
    apparent_error_um: Triple


class SuspectedStepSection(StrictModel):
    """Error that may have changed suddenly during the measurement, in an estimate file.

    `probability` is that of this error if one error has changed. The change lies between the balls `last_before` and
    `first_after`, each given by the number of its position and its ball number. `change` is its size in `unit`.
    """

    error: str
    change: float
    unit: Literal["µm", "µrad"]
    probability: Probability
    last_before: tuple[int, int]
    first_after: tuple[int, int]


class HiddenStepSection(StrictModel):
    """Largest sudden change between the two positions `between` that could have stayed unnoticed. It leaves the
    volumetric error `vce_um`."""

    error: str
    change: float
    unit: Literal["µm", "µrad"]
    vce_um: float = Field(ge=0.0)
    between: tuple[int, int] | None


class StepSection(StrictModel):
    """Result of the test for a sudden change of the machine during the measurement, in an estimate file. `false_alarm`
    is the largest probability of such measurements on a machine that did not change."""

    false_alarm: float = Field(ge=0.0, le=1.0)
    suspects: tuple[SuspectedStepSection, ...]
    hidden: HiddenStepSection | None


class ShiftPatternSection(StrictModel):
    """Pattern of shifts over all positions in an estimate file: what may be shifted and where, in words, the size of
    the shift and the probability of this cause if there is a pattern."""

    text: str
    size_um: float
    probability: Probability


class PatternSection(StrictModel):
    """Result of the test for a pattern of shifts in an estimate file. `false_alarm` is the largest probability of such
    measurements if there is no pattern."""

    false_alarm: float = Field(ge=0.0, le=1.0)
    suspects: tuple[ShiftPatternSection, ...]


class BallShiftSection(StrictModel):
    """Shift of the balls in an estimate file that was estimated with the errors of the machine: the name of its unknown
    (`lost motion X`, `sag`), its size and the standard uncertainty of the size."""

    name: str
    size_um: float
    standard_uncertainty_um: float = Field(ge=0.0)


class CommonScaleSection(StrictModel):
    """Result of the test of the scale that all axes have in common, in an estimate file. `false_alarm` is the largest
    probability of such a scale if the family of the machine and the stated uncertainties of the artefact are right.

    The last four values are the errors (stated or read minus true value) of which each alone would explain the scale;
    None if it explains nothing.
    """

    scale_um_per_m: float
    standard_uncertainty_um_per_m: float = Field(ge=0.0)
    expected_um_per_m: float = Field(ge=0.0)
    axes_um_per_m: Triple
    false_alarm: float = Field(ge=0.0, le=1.0)
    temperature_k: float | None
    length_um: float
    length_mm: float
    cte_per_k: float | None


class VolumetricSection(StrictModel):
    """Volumetric errors over the workspace in µm for the tool of the table, after removal of the best-fitting rigid
    motion.

    `estimated_ve_um` is that of the machine without compensation, and `predicted_vce_um` is expected with compensation.
    The limits are those of the equal-tailed 95 % intervals; they are None if they were not computed.
    """

    estimated_ve_um: float
    estimated_ve_limits_um: Pair | None
    predicted_vce_um: float
    predicted_vce_limits_um: Pair | None


class EstimateFile(StrictModel):
    """Content of an estimate file. `artefact_calibration` is written for other programs; it follows from
    `carried_over`."""

    format: Literal["volcal estimate 3"]
    provenance: dict[str, str]
    formulation: Literal["centres", "distances"]
    model: EstimatedModelSection
    tool_offsets_mm: tuple[Triple, ...]
    parameters: tuple[ParameterSection, ...]
    covariance: tuple[tuple[float, ...], ...]
    rank: int
    conditioning: float
    null_summary: tuple[str, ...]
    null_directions: tuple[NullDirectionSection, ...]
    chi2_normalised: float
    degrees_of_freedom: float
    scales: ScalesSection
    scales_at_bounds: tuple[str, ...]
    order_evidence: tuple[OrderSection, ...]
    rejected: tuple[RejectedBallSection, ...]
    certificate: tuple[CertificateSection, ...]
    step_in_run: StepSection | None = None
    shift_pattern: PatternSection | None = None
    ball_shifts: tuple[BallShiftSection, ...] = ()
    common_scale: CommonScaleSection | None = None
    instruments: tuple[InstrumentSection, ...] = ()
    artefact_calibration: dict[str, Any] | None
    volumetric: VolumetricSection | None
    carried_over: CarriedOverSection


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

    def carried_over(self) -> CarriedOverPrior:
        """Return this estimate as the prior of a later estimate, without process noise: the machine is assumed not to
        have changed in between. Raise DataError if the covariance is singular."""
        scales = self.document.scales.scales
        factor = DriftFactor(**self.document.carried_over.drift_factor.model_dump())
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
    unit = covariance / np.multiply.outer(scale, scale)
    if np.abs(unit - unit.T).max() > _ASYMMETRY:
        raise FormatError("the covariance is not symmetric", file=source, key="covariance")
    if np.linalg.eigvalsh(unit)[0] < -_INDEFINITE:
        raise FormatError("the covariance is not positive semi-definite", file=source, key="covariance")
    return covariance
