"""Sections of an estimate file, as pydantic models: what is checked when a file is read."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import AfterValidator, Field, model_validator

from twin.formats.instrument_section import InstrumentSection
from twin.formats.prior_section import CarriedOverSection
from twin.formats.toml_reading import StrictModel
from twin.identification import Scales

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
