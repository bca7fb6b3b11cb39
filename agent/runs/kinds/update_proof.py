"""Proof of the compensation table that a nightly run has updated, by the held-out positions of the night (measured, but
not used for the estimate).

The proof of a full calibration requires that the table removes most of the error. From one night to the next, however,
a table changes by less than the repeatability of the touches. The proof of an update therefore has only two conditions.
The residuals of the held-out balls must be as predicted, and they must not have increased by more than their noise
explains.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from agent.errors import MeasurementFault
from agent.files import translated
from agent.planning.job import Job
from agent.probing.position import MeasuredBall
from agent.results.estimation import EstimationResult
from agent.results.observations import certified_balls, displayed_residuals, observations_of
from agent.results.run_outcome import Proof
from twin.artefact.held_out_check import HeldOutResiduals, held_out_test
from twin.artefact.observations import Observations
from twin.identification import residual_covariance
from twin.units import UM_PER_MM

_COVERAGE = 3.0


def prove_update(
    job: Job, estimation: EstimationResult, before: Sequence[MeasuredBall], after: Sequence[MeasuredBall]
) -> Proof:
    """Return the proof of an updated compensation table. The held-out balls `before` (balls not used for the estimate),
    measured before activation of the new table, are compared with the held-out balls `after`, measured after its
    activation.

    Raises MeasurementFault if too few held-out balls were measured.
    """
    before, after = certified_balls(before, job.artefact), certified_balls(after, job.artefact)
    for balls, when in ((before, "before"), (after, "with the new table active")):
        if not balls:
            raise MeasurementFault(f"no ball of a held-out position was measured {when}")
    with translated(MeasurementFault):
        observed = observations_of(after, job.tool_offset_mm, estimation.table.at)
        result, former = (
            displayed_residuals(after, job.tool_offset_mm, job.artefact),
            displayed_residuals(before, job.tool_offset_mm, job.artefact),
        )
        covariance = residual_covariance(estimation.estimate, observed.axis_positions, job.tool_offset_mm)
        expected = held_out_test(observed, result, job.artefact, covariance)
    deviations = [_deviation(one, observed, estimation.estimate.scales.noise) for one in (former, result)]
    worse = result.rms_mm**2 - former.rms_mm**2 > _COVERAGE * math.hypot(*deviations)
    limit = job.settings.verification.max_chi2
    reason = ""
    if worse:
        before_um, after_um = UM_PER_MM * former.rms_mm, UM_PER_MM * result.rms_mm
        reason = f"held-out positions became worse, {before_um:.2f} to {after_um:.2f} µm, by more than their noise"
    elif expected.chi2_normalised > limit:
        chi2 = expected.chi2_normalised
        reason = f"held-out positions are not as predicted: normalised χ² {chi2:.2f}, allowed {limit:.2f}"
    return Proof(
        accepted=not reason,
        before_um=UM_PER_MM * former.rms_mm,
        after_um=UM_PER_MM * result.rms_mm,
        predicted_um=UM_PER_MM * expected.predicted_mm,
        chi2_normalised=expected.chi2_normalised,
        reason=reason or "no worse than before and as predicted",
    )


def _deviation(result: HeldOutResiduals, observed: Observations, scale: float) -> float:
    """Return the standard deviation (mm²) of the mean squared residual of a ball that is due to touch noise alone.

    For a systematic part s of the residuals and noise n with f independent components of standard deviation σ, |s + n|²
    has the variance 4 |s|² σ² + 2 f σ⁴. `scale` is the factor of the stated noise.
    """
    variance = scale**2 * float(np.einsum("nii->n", observed.covariance).mean()) / 3.0
    freedom = result.freedom
    square = result.rms_mm**2 * freedom / 3.0
    systematic = max(square - freedom * variance, 0.0)  # |s|²: the mean of |s + n|² is |s|² + f σ²
    return 3.0 / freedom * math.sqrt(4.0 * systematic * variance + 2.0 * freedom * variance**2)
