"""Reconstruction of an estimate of the machine's errors from the journal of its run, for a report."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from twin.arrays import Array
from twin.artefact.artefact_calibration import ArtefactCalibration
from twin.formats.estimate_file import StoredEstimate
from twin.identification import BallCheck, Misfit, Scales
from twin.machine.error_model import ErrorModel


@dataclass(frozen=True, eq=False)
class JournalEstimate:
    """Estimate of a machine's errors that was read from the journal of a run. A report uses it in place of an
    `Estimate`.

    `misfit` is the estimated part of the error field that the error model cannot represent; it is None if the run did
    not estimate it.
    """

    model: ErrorModel
    formulation: str
    parameters: Array
    covariance: Array
    misfit: Misfit | None
    chi2_normalised: float
    degrees_of_freedom: float
    rejected: tuple[tuple[int, int, int], ...]
    scales: Scales
    rank: int
    conditioning: float
    null_summary: tuple[str, ...]
    certificate_check: tuple[BallCheck, ...]
    artefact_calibration: ArtefactCalibration | None

    @property
    def standard_uncertainty(self) -> Array:
        """Standard uncertainties (p,) of the p parameters of the error model, each in mm or rad."""
        return np.sqrt(np.maximum(np.diagonal(self.covariance), 0.0))


def journal_estimate(stored: StoredEstimate, unresolved_mm2: float) -> JournalEstimate:
    """Return the estimate of a run in the form that a report shows. `stored` is the estimate as the journal contains
    it.

    `unresolved_mm2` is the variance, in mm² for each direction, of a part of the misfit. This part varies over
    distances too short for the functions (modes) by which the misfit is estimated.
    """
    document = stored.document
    return JournalEstimate(
        model=stored.model,
        formulation=document.formulation,
        parameters=stored.parameters,
        covariance=stored.covariance,
        misfit=_misfit(stored, unresolved_mm2),
        chi2_normalised=document.chi2_normalised,
        degrees_of_freedom=document.degrees_of_freedom,
        rejected=tuple((row.position, row.ball, row.tool) for row in document.rejected),
        scales=document.scales.scales,
        rank=document.rank,
        conditioning=document.conditioning,
        null_summary=document.null_summary,
        certificate_check=stored.certificate_check,
        artefact_calibration=stored.artefact_calibration,
    )


def _misfit(stored: StoredEstimate, unresolved_mm2: float) -> Misfit | None:
    unknowns = stored.unknowns
    if unknowns.modes is None:
        return None
    own, misfit = unknowns.blocks.parameters, unknowns.blocks.misfit
    covariance = stored.z_covariance
    return Misfit(
        modes=unknowns.modes,
        amplitude_mm=unknowns.misfit_mm,
        coefficients=stored.z[misfit],
        covariance=covariance[misfit, misfit],
        cross_covariance=unknowns.scale[:, None] * covariance[own, misfit],
        unresolved_mm2=unresolved_mm2,
    )
