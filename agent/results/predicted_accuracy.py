"""Prediction of the accuracy of a run from the ball positions of its preflight (simulated execution of the complete
run).

The prediction is possible because the covariance of the estimate depends on the ball positions, but not on the measured
values.
"""

from __future__ import annotations

from dataclasses import dataclass

from agent.files import translated
from agent.planning.job import Job
from agent.probing.run_plan import MeasuredPositions
from agent.results.observations import no_correction, observations_of
from drivers.errors import ConfigurationError
from twin.identification import Estimate, Options, identify, predicted_vce
from twin.machine.volumetric import VolumetricRms, evaluation_grid


@dataclass(frozen=True)
class PredictedAccuracy:
    rank: int
    parameters: int
    vce: VolumetricRms


def predict_accuracy(job: Job, measured: MeasuredPositions) -> PredictedAccuracy:
    """Return the rank of the estimate and the volumetric compensated error (VCE) that are predicted for the positions
    `measured` in a preflight (simulated run).

    The held-out positions, which serve only for the proof of the table, are not used. Raises ConfigurationError if the
    other positions cannot identify the machine.
    """
    estimate = preflight_estimate(job, measured)
    grid = evaluation_grid(job.machine.model.ranges_mm)
    vce = predicted_vce(estimate, grid, job.tool_offset_mm)
    return PredictedAccuracy(estimate.rank, estimate.model.size, vce)


def preflight_estimate(job: Job, measured: MeasuredPositions) -> Estimate:
    """Return the estimate from the balls of a preflight (simulated run). Its covariance is the covariance predicted for
    the run.

    Raises ConfigurationError if the position set cannot identify the machine.
    """
    chosen = job.settings.identification
    options = Options(
        formulation=chosen.formulation,
        use_prior=chosen.prior,
        weights=chosen.weights,
        temperature_standard_uncertainty_k=job.settings.temperature.standard_uncertainty_k,
        estimate_scales=False,
        outliers="none",
    )
    with translated(ConfigurationError, key="procedure.position_set", set=job.settings.procedure.position_set):
        observations = observations_of(job.balls_of(measured, held_out=False), job.tool_offset_mm, no_correction)
        return identify(job.machine.model, observations, job.artefact, job.machine.family, options)
