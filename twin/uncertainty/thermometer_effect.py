"""Effect of the artefact's thermometer on the error that remains after compensation.

An error of the thermometer stretches the artefact in all positions alike. No number of positions shows it, except by
the difference from machines of the same kind, so it remains in the scales of all axes.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from twin.arrays import Array
from twin.identification import Estimate
from twin.identification.predicted import expected_vce
from twin.machine.volumetric import VolumetricRms


@dataclass(frozen=True)
class ThermometerEffect:
    """Part of the predicted volumetric compensated error (VCE) that is due to the thermometer of the artefact.

    `standard_uncertainty_k` is the standard uncertainty of the artefact's temperature in K, and `strain` is the
    relative change of the artefact's length that it causes. `contribution` is the part of the predicted VCE that would
    vanish if the error of the thermometer were known. `without` is the VCE predicted for that case: the squares of both
    add up to the square of the predicted VCE.
    """

    standard_uncertainty_k: float
    strain: float
    contribution: VolumetricRms
    without: VolumetricRms


def thermometer_effect(estimate: Estimate, forms: tuple[Array, Array]) -> ThermometerEffect:
    """Return the effect of the thermometer on the VCE that is predicted from `estimate`. `forms` are the two quadratic
    forms of the error field over the workspace that `twin.identification.predicted.field_forms` returns.

    With the covariance C of all unknowns and the column c of the thermometer's error, whose variance is v, knowledge of
    this error would reduce C by c c' / v. The form Q of the mean square over the workspace makes this c' Q c / v.
    """
    vce, unknowns = expected_vce(estimate, forms), estimate.unknowns
    artefact, blocks = unknowns.artefact, unknowns.blocks
    if "thermometer" not in artefact.strain_names:
        return ThermometerEffect(0.0, 0.0, VolumetricRms(0.0, 0.0), vce)
    index = blocks.strain.start + artefact.strain_names.index("thermometer")
    column = estimate.z_covariance[:, index]
    misfit = column[blocks.misfit] if estimate.misfit is not None else np.zeros(0)
    # the field of one standard deviation of the thermometer's error as the measurements leave it, c / √v
    moved = np.concatenate((unknowns.scale * column[blocks.parameters], misfit)) / np.sqrt(column[index])
    raw, aligned = (float(moved @ form @ moved) for form in forms)
    return ThermometerEffect(
        standard_uncertainty_k=artefact.thermometer_standard_uncertainty_k,
        strain=artefact.cte_per_k * artefact.thermometer_standard_uncertainty_k,
        contribution=_rms(raw, aligned),
        without=_rms(vce.raw_mm**2 - raw, vce.aligned_mm**2 - aligned),
    )


def _rms(raw_mm2: float, aligned_mm2: float) -> VolumetricRms:
    return VolumetricRms(float(np.sqrt(max(raw_mm2, 0.0))), float(np.sqrt(max(aligned_mm2, 0.0))))
