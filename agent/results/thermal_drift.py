"""The drift of the machine while it was measured: which balls tell of it, and the course that it is fitted along."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from agent.planning.job import Job
from agent.planning.temperature_rules import drift_prior_of
from agent.probing.position import MeasuredBall
from agent.probing.repeated_positions import machine_change_k
from agent.probing.run_plan import Measured
from agent.results.observations import Correction, observations_of
from agent.settings.schema import Settings
from twin.artefact.observations import Observations
from twin.artefact.thermal_regressors import smooth_readings, thermal_regressors
from twin.identification import CarriedOverPrior, Options


def balls_for_estimate(job: Job, measured: Measured) -> list[MeasuredBall]:
    """All but those of held-out positions; where the machine drifted, also the first of each position found again."""
    balls = job.balls_of(measured, held_out=False)
    return job.balls_of(measured, held_out=False, again=True) if is_drifting(job.settings, balls) else balls


def is_drifting(settings: Settings, balls: Sequence[MeasuredBall]) -> bool:
    """Whether the machine has changed by more than may be neglected."""
    chosen = settings.temperature
    return chosen.fit_machine_drift and change_k(settings, balls) >= chosen.min_change_k


def change_k(settings: Settings, balls: Sequence[MeasuredBall]) -> float:
    """Of the machine while these balls were measured."""
    return machine_change_k([ball.conditions for ball in balls], settings.temperature.declared_change_k)


def observed(job: Job, balls: Sequence[MeasuredBall], correction: Correction) -> Observations:
    """Observations with the machine's course to the last of them, where it drifted."""
    if not is_drifting(job.settings, balls):
        return observations_of(balls, job.tool_offset_mm, correction)
    instants_s = np.array([ball.conditions.instant_s for ball in balls])
    told = [ball.conditions.machine_c for ball in balls]
    known = [value for value in told if value is not None]
    machine_c = np.array(known) if len(known) == len(balls) else None
    course = thermal_regressors(instants_s, machine_c, change_k(job.settings, balls))
    seen = observations_of(balls, job.tool_offset_mm, correction, course)
    return replace(seen, temperature_c=smooth_readings(instants_s, seen.temperature_c))


def options_of(settings: Settings, seen: Observations) -> Options:
    """How a run identifies from the family: the machine as it was at the last of the observations."""
    chosen = settings.identification
    warm = _warm(settings, seen)
    return replace(warm, formulation=chosen.formulation, use_prior=chosen.prior, weights=chosen.weights)


def going_on(settings: Settings, seen: Observations, known: CarriedOverPrior) -> Options:
    """How a night goes on from what is known before."""
    return replace(_warm(settings, seen), carried_over=known)


def _warm(settings: Settings, seen: Observations) -> Options:
    drifted = seen.thermal_regressors.shape[1] > 0
    return Options(
        temperature_standard_uncertainty_k=settings.temperature.standard_uncertainty_k,
        drift=drift_prior_of(settings) if drifted else None,
        state_regressors=seen.thermal_regressors[-1] if drifted else None,
    )
