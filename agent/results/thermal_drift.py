"""Treatment of the machine's thermal drift during a run: selection of the balls, thermal regressors and options of the
identification."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from agent.planning.job import Job
from agent.planning.temperature_rules import drift_prior_of
from agent.probing.position import MeasuredBall
from agent.probing.repeated_positions import machine_change_k
from agent.probing.run_plan import MeasuredPositions
from agent.results.observations import Correction, observations_of
from agent.settings.schema import IdentificationSettings
from agent.settings.temperature import TemperatureSettings
from twin.arrays import Array
from twin.artefact.observations import Observations
from twin.artefact.thermal_regressors import smooth_readings, thermal_regressors
from twin.identification import CarriedOverPrior, Estimate, Options
from twin.machine.forward_model import deviation_basis


def balls_for_estimate(job: Job, measured: MeasuredPositions) -> list[MeasuredBall]:
    """Return the measured balls for the estimate. These are all balls except those of held-out positions, which serve
    only for the proof of the table.

    The first ball of each position is measured again at the end of the position. If the machine drifted, these repeated
    measurements are included.
    """
    balls = job.balls_of(measured, held_out=False)
    return job.balls_of(measured, held_out=False, again=True) if is_drifting(job.settings.temperature, balls) else balls


def is_drifting(temperature: TemperatureSettings, balls: Sequence[MeasuredBall]) -> bool:
    """Return True if the settings ask for a fit of the machine's thermal drift and the machine's temperature has
    changed by at least `temperature.min_change_k`."""
    return temperature.fit_machine_drift and change_k(temperature, balls) >= temperature.min_change_k


def change_k(temperature: TemperatureSettings, balls: Sequence[MeasuredBall]) -> float:
    """Return the change in K of the machine's temperature during the measurement of `balls`. If the machine has no
    thermometer, the change that the settings declare is returned."""
    return machine_change_k([ball.conditions for ball in balls], temperature.declared_change_k)


def observations_with_drift(job: Job, balls: Sequence[MeasuredBall], correction: Correction) -> Observations:
    """Return the observations of the machine without compensation. If the machine drifted, the observations contain
    regressors of the thermal drift (temperature changes on which it depends) and smoothed temperatures of the
    artefact."""
    if not is_drifting(job.settings.temperature, balls):
        return observations_of(balls, job.tool_offset_mm, correction)
    instants_s = np.array([ball.conditions.instant_s for ball in balls])
    readings = [ball.conditions.machine_c for ball in balls]
    known = [value for value in readings if value is not None]
    machine_c = np.array(known) if len(known) == len(balls) else None
    regressors = thermal_regressors(instants_s, machine_c, change_k(job.settings.temperature, balls))
    observations = observations_of(balls, job.tool_offset_mm, correction, regressors)
    return replace(observations, temperature_c=smooth_readings(instants_s, observations.temperature_c))


def earlier_deviations(
    job: Job, measured: MeasuredPositions, balls: Sequence[MeasuredBall], estimate: Estimate, regressors: Array
) -> Array:
    """Return the deviations (n, 3) in mm of the machine at the time when the n `balls` were measured, minus those in
    the state that `estimate` describes, which is the end of the measurement. They are zero if the estimate contains no
    drift.

    `regressors` (m, w) contains the thermal regressors in K of the m balls in `measured` from which the estimate was
    made.
    """
    positions = np.array([ball.found.centre_mm for ball in balls])
    if estimate.drift is None:
        return np.zeros_like(positions)
    known_s = np.array([ball.conditions.instant_s for ball in balls_for_estimate(job, measured)])
    instants_s, by_time = [ball.conditions.instant_s for ball in balls], np.argsort(known_s)
    course = [np.interp(instants_s, known_s[by_time], column[by_time]) for column in regressors.T]
    basis = deviation_basis(estimate.model, positions, job.tool_offset_mm)
    return estimate.drift.deviations(basis, np.stack(course, axis=1) - regressors[-1])


def identification_options(
    identification: IdentificationSettings, temperature: TemperatureSettings, observations: Observations
) -> Options:
    """Return the options for an identification of the machine's errors without a prior from earlier nights.

    If the machine drifted, the estimate describes the machine at the time of the last observation.
    """
    return replace(
        _drift_options(temperature, observations),
        formulation=identification.formulation,
        use_prior=identification.prior,
        weights=identification.weights,
    )


def fusion_options(temperature: TemperatureSettings, observations: Observations, known: CarriedOverPrior) -> Options:
    """Return the options for an identification of the machine's errors that combines the observations of a night with
    the prior `known` from earlier nights."""
    return replace(_drift_options(temperature, observations), carried_over=known)


def _drift_options(temperature: TemperatureSettings, observations: Observations) -> Options:
    drifted = observations.thermal_regressors.shape[1] > 0
    return Options(
        temperature_standard_uncertainty_k=temperature.artefact_uncertainty_k,
        drift=drift_prior_of(temperature) if drifted else None,
        state_regressors=observations.thermal_regressors[-1] if drifted else None,
    )
