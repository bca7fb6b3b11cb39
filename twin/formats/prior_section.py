"""Section of an estimate file with the data needed to use the estimate as a prior: the joint mean and covariance of all
unknowns, and the meaning of each unknown.

The modes of the misfit are stored explicitly, since another computer may compute the same modes with opposite signs.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from pydantic import Field

from twin.arrays import Array
from twin.errors import FormatError
from twin.formats.drift_section import DriftTrendSection, trend_document
from twin.formats.stored_arrays import lower_triangle, stored_array, symmetric_matrix
from twin.formats.toml_reading import StrictModel
from twin.identification.drift_trend import DriftTrend
from twin.identification.misfit import MISFIT_KINDS, MisfitModes
from twin.identification.prior_from_estimate import DriftFactor
from twin.identification.unknowns import ArtefactErrors, Sag, Unknowns
from twin.machine.error_model import ErrorModel

Row = tuple[float, ...]
Rows = tuple[Row, ...]
Triple = tuple[float, float, float]

KEY = "carried_over"


class ArtefactSection(StrictModel):
    """Identity of an artefact with N balls, and its uncertainties.

    `certificate_mm` is a matrix L in mm with 3N rows; the covariance of the calibrated ball centres is the product L
    Lᵀ.
    """

    balls_mm: tuple[Triple, ...]
    cte_per_k: float
    certificate_mm: Rows
    cte_standard_uncertainty_per_k: float
    thermometer_standard_uncertainty_k: float
    uncertified_balls: tuple[int, ...] = ()
    sag_mm: float = Field(default=0.0, ge=0.0)
    sag_standard_uncertainty_mm: float = Field(default=0.0, ge=0.0)


class MisfitSection(StrictModel):
    """Modes of the misfit, the part of the true error field that the model cannot represent. `rms_mm` is the prior rms
    of the misfit over the workspace in mm. All other entries have the meanings of the fields of
    `twin.identification.misfit.MisfitModes`."""

    rms_mm: float
    tool_offset_mm: Triple
    degrees: tuple[tuple[int, int, int], ...]
    mixing: tuple[Rows, Rows, Rows]
    removed: Rows
    rigid: Rows
    sizes: tuple[int, ...]
    left_out: Row


class DriftFactorSection(StrictModel):
    """Factor on the process noise between nights, as stored in an estimate file. `value` is its median, and
    `log_deviation` is the standard deviation of its natural logarithm."""

    value: float = Field(gt=0.0)
    log_deviation: float = Field(ge=0.0)


class CarriedOverSection(StrictModel):
    """Posterior mean and covariance of all unknowns of an identification, as stored in an estimate file for use as a
    prior.

    `mean` and `covariance` are in units of the prior standard deviations. Only the lower triangle of the covariance is
    stored, row by row. `scale` contains the unit of each parameter in mm or rad. `drift_factor` and `trend` are absent
    if no night has told anything about the drift yet. `stated_noise_mm2` is the stated variance in mm² of one
    coordinate of a measured ball centre. `joined_readings` are the checksums of readings of other instruments that are
    part of the estimate.
    """

    scale: Row
    artefact: ArtefactSection
    misfit: MisfitSection | None
    mean: Row
    covariance: Rows
    drift_factor: DriftFactorSection = DriftFactorSection(**vars(DriftFactor()))
    stated_noise_mm2: float = Field(default=0.0, ge=0.0)
    trend: DriftTrendSection = DriftTrendSection()
    joined_readings: tuple[str, ...] = ()


def carried_over_document(
    unknowns: Unknowns, mean: Array, covariance: Array, drift_factor: DriftFactor, trend: DriftTrend
) -> dict[str, Any]:
    """Return the section of an estimate file that makes the estimate usable as a prior, as a JSON object."""
    errors = unknowns.artefact
    return {
        "scale": unknowns.scale.tolist(),
        "artefact": {
            "balls_mm": errors.balls.tolist(),
            "cte_per_k": errors.cte_per_k,
            "certificate_mm": errors.certificate.tolist(),
            "cte_standard_uncertainty_per_k": errors.cte_standard_uncertainty_per_k,
            "thermometer_standard_uncertainty_k": errors.thermometer_standard_uncertainty_k,
            "uncertified_balls": list(errors.uncertified),
            "sag_mm": errors.sag.stated_mm,
            "sag_standard_uncertainty_mm": errors.sag.standard_uncertainty_mm,
        },
        "misfit": None if unknowns.modes is None else _misfit_document(unknowns.modes, unknowns.misfit_mm),
        "mean": mean.tolist(),
        "covariance": lower_triangle(covariance),
        **({} if drift_factor == DriftFactor() else {"drift_factor": vars(drift_factor)}),
        "stated_noise_mm2": unknowns.stated_noise_mm2,
        **({"trend": trend_document(trend, unknowns)} if trend else {}),
    }


def _misfit_document(modes: MisfitModes, rms_mm: float) -> dict[str, Any]:
    return {
        "rms_mm": rms_mm,
        "tool_offset_mm": modes.tool_offset.tolist(),
        "degrees": [list(degrees) for degrees in modes.degrees],
        "mixing": modes.mixing.tolist(),
        "removed": modes.removed.tolist(),
        "rigid": modes.rigid.tolist(),
        "sizes": list(modes.sizes),
        "left_out": modes.left_out.tolist(),
    }


def read_unknowns(section: CarriedOverSection, model: ErrorModel, source: str) -> Unknowns:
    """Return the unknowns that the section `section` of an estimate file describes. Raise FormatError, which names
    `source` and the key, if the sizes in the section do not match."""
    artefact, misfit = section.artefact, section.misfit
    balls = len(artefact.balls_mm)
    width = len(artefact.certificate_mm[0]) if artefact.certificate_mm else 0
    errors = ArtefactErrors(
        balls=_array(artefact.balls_mm, (balls, 3), source, "artefact.balls_mm"),
        cte_per_k=artefact.cte_per_k,
        certificate=_array(artefact.certificate_mm, (3 * balls, width), source, "artefact.certificate_mm"),
        cte_standard_uncertainty_per_k=artefact.cte_standard_uncertainty_per_k,
        thermometer_standard_uncertainty_k=artefact.thermometer_standard_uncertainty_k,
        uncertified=artefact.uncertified_balls,
        sag=Sag(artefact.sag_mm, artefact.sag_standard_uncertainty_mm),
    )
    scale = _array(section.scale, (model.size,), source, "scale")
    modes = None if misfit is None else _modes(misfit, model, source)
    rms_mm = 0.0 if misfit is None else misfit.rms_mm
    return Unknowns(model, scale, errors, modes, rms_mm, stated_noise_mm2=section.stated_noise_mm2)


def _modes(section: MisfitSection, model: ErrorModel, source: str) -> MisfitModes:
    count = len(section.rigid[0]) if section.rigid else 0
    mixing = (3, len(section.degrees), count)
    return MisfitModes(
        model=model,
        tool_offset=np.array(section.tool_offset_mm),
        degrees=section.degrees,
        mixing=_array(section.mixing, mixing, source, "misfit.mixing"),
        removed=_array(section.removed, (model.size, count), source, "misfit.removed"),
        rigid=_array(section.rigid, (6, count), source, "misfit.rigid"),
        sizes=_sizes(section.sizes, count, source),
        left_out=_array(section.left_out, (len(MISFIT_KINDS),), source, "misfit.left_out"),
    )


def _sizes(sizes: tuple[int, ...], count: int, source: str) -> tuple[int, ...]:
    if len(sizes) != len(MISFIT_KINDS) or min(sizes) < 0 or sum(sizes) != count:
        message = f"{len(MISFIT_KINDS)} non-negative numbers with the sum {count} are required"
        raise FormatError(message, file=source, key=f"{KEY}.misfit.sizes")
    return sizes


def read_moments(section: CarriedOverSection, size: int, source: str) -> tuple[Array, Array]:
    """Return the mean (P,) and the covariance (P, P) of the P unknowns from a section of an estimate file. `size` is
    the expected number P. Raise FormatError if the stored sizes differ from P."""
    mean = _array(section.mean, (size,), source, "mean")
    covariance = symmetric_matrix(section.covariance, size, source, f"{KEY}.covariance")
    return mean, covariance


def _array(values: object, shape: tuple[int, ...], source: str, key: str) -> Array:
    return stored_array(values, shape, source, f"{KEY}.{key}")
