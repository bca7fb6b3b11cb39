"""Prediction of the accuracy of a run from the ball positions of its preflight.

The prediction is possible because the covariance of the estimate depends on the ball positions, but not on the measured
values.
"""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import AbstractContextManager
from dataclasses import dataclass

from agent.files import translated
from agent.planning.job import Job
from agent.probing.measured_balls import MeasuredBall, no_correction, observations_of
from agent.probing.run_plan import MeasuredPositions
from agent.results.observations import ReferenceArtefact
from drivers.errors import ConfigurationError
from twin.artefact.held_out_check import held_out_residuals
from twin.artefact.observations import Observations
from twin.artefact.position_set import MIN_BALLS, Position
from twin.identification import Estimate, Options, identify, predicted_vce, residual_covariance
from twin.machine.volumetric import VolumetricRms, evaluation_grid
from twin.units import UM_PER_MM


@dataclass(frozen=True)
class PredictedAccuracy:
    """Accuracy that is predicted for a run.

    `vce` is the volumetric compensated error (VCE). `held_out_um` maps each held-out position to the rms residual in µm
    that its balls are expected to show with the new table active.
    """

    rank: int
    parameters: int
    vce: VolumetricRms
    held_out_um: Mapping[Position, float]


def predict_accuracy(job: Job, measured: MeasuredPositions) -> PredictedAccuracy:
    """Return the rank of the estimate, the volumetric compensated error (VCE) and the residuals of the held-out
    positions that are predicted for the positions `measured` in a preflight.

    The held-out positions, which serve only for the proof of the table, are not used for the estimate. Raises
    ConfigurationError if the other positions cannot identify the machine.
    """
    estimate = preflight_estimate(job, measured)
    grid = evaluation_grid(job.machine.model.ranges_mm)
    vce = predicted_vce(estimate, grid, job.tool_offset_mm)
    return PredictedAccuracy(estimate.rank, estimate.model.size, vce, _held_out_um(job, measured, estimate))


def _held_out_um(job: Job, measured: MeasuredPositions, estimate: Estimate) -> dict[Position, float]:
    """Return the predicted rms residual in µm of each measured held-out position. It contains the remaining error of
    the machine, the noise of the touches and the uncertainty of the certificate."""
    by_position: dict[Position, list[MeasuredBall]] = {position: [] for position in job.held_out}
    for ball in job.balls_of(measured, held_out=True):
        by_position[Position(ball.station, ball.azimuth_deg, ball.elevation_deg)].append(ball)
    predicted = {}
    reference = ReferenceArtefact.of(job.artefact, estimate.unknowns, estimate.z, estimate.z_covariance)
    for position, balls in by_position.items():
        if len(balls) >= MIN_BALLS:
            seen = observations_of(balls, job.tool_offset_mm, no_correction)
            result = held_out_residuals(seen, seen.axis_positions + job.tool_offset_mm, reference.artefact)
            left = residual_covariance(estimate, seen.axis_positions, job.tool_offset_mm)
            covariance = reference.covariance(seen, result, left, job.tool_offset_mm)
            predicted[position] = UM_PER_MM * covariance.predicted_rms_mm
    return predicted


def preflight_estimate(job: Job, measured: MeasuredPositions) -> Estimate:
    """Return the estimate from the balls of a preflight. Its covariance is the covariance predicted for the run.

    Raises ConfigurationError if the position set cannot identify the machine.
    """
    with _position_set_named(job):
        balls = job.balls_of(measured, held_out=False)
        return planned_estimate(job, observations_of(balls, job.tool_offset_mm, no_correction))


def planned_estimate(job: Job, observations: Observations) -> Estimate:
    """Return the estimate from planned observations (ball centres that an error-free machine measures). Its covariance
    is the covariance predicted for a run of `job`.

    Raises ConfigurationError if the observations cannot identify the machine.
    """
    chosen = job.settings.identification
    options = Options(
        formulation=chosen.formulation,
        use_prior=chosen.prior,
        weights=chosen.weights,
        temperature_standard_uncertainty_k=job.settings.temperature.artefact_uncertainty_k,
        estimate_scales=False,
        outliers="none",
    )
    with _position_set_named(job):
        return identify(job.machine.model, observations, job.artefact, job.machine.family, options)


def _position_set_named(job: Job) -> AbstractContextManager[None]:
    return translated(ConfigurationError, key="procedure.position_set", set=job.settings.procedure.position_set)
