"""Accuracy that a procedure will reach, predicted from its ball positions: a covariance needs no measurement."""

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
    """Return rank and predicted VCE of the set as measured in a preflight, without the held-out positions.

    Raises ConfigurationError if the set cannot identify the machine.
    """
    estimate = preflight_estimate(job, measured)
    grid = evaluation_grid(job.machine.model.ranges_mm)
    vce = predicted_vce(estimate, grid, job.tool_offset_mm)
    return PredictedAccuracy(estimate.rank, estimate.model.size, vce)


def preflight_estimate(job: Job, measured: MeasuredPositions) -> Estimate:
    """Return the estimate from the balls of a preflight: its covariance is that of the run to come.

    Raises ConfigurationError if the set cannot identify the machine.
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
