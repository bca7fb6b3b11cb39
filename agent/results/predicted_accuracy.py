"""What a procedure will be worth, from where its balls will be: no measurement is needed for a covariance."""

from __future__ import annotations

from dataclasses import dataclass

from agent.files import translated
from agent.planning.job import Job
from agent.probing.run_plan import Measured
from agent.results.observations import no_correction, observations_of
from drivers.errors import ConfigurationError
from twin.identification import Estimate, Options, identify, predicted_vce
from twin.machine.volumetric import Volumetric, evaluation_grid


@dataclass(frozen=True)
class Expectation:
    rank: int
    parameters: int
    vce: Volumetric


def expect(job: Job, rehearsed: Measured) -> Expectation:
    """Rank and predicted VCE of the set as rehearsed, held-out positions left aside.

    Raises ConfigurationError where the set cannot identify the machine.
    """
    estimate = rehearsed_estimate(job, rehearsed)
    grid = evaluation_grid(job.machine.model.ranges_mm)
    vce = predicted_vce(estimate, grid, job.tool_offset_mm)
    return Expectation(estimate.rank, estimate.model.size, vce)


def rehearsed_estimate(job: Job, rehearsed: Measured) -> Estimate:
    """What the balls of the rehearsal identify: its covariance is that of the night to come.

    Raises ConfigurationError where the set cannot identify the machine.
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
        observations = observations_of(job.balls_of(rehearsed, held_out=False), job.tool_offset_mm, no_correction)
        return identify(job.machine.model, observations, job.artefact, job.machine.family, options)
