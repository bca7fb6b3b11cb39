"""Change of a machine since the last accepted night: the expected change, and the change according to a new
estimate."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from agent.planning.expected_walk import expected_walk
from agent.planning.job import Job
from agent.runs.reference_state import ReferenceState
from twin.arrays import Array
from twin.artefact.observations import Observations
from twin.identification import CarriedOverPrior, Estimate, Options
from twin.machine.error_model import ErrorModel
from twin.machine.forward_model import deviation_basis
from twin.machine.volumetric import QuadraticForm, evaluation_grid, volumetric_error
from twin.monitoring.night_fit import NightFit, compare_with_nights_before
from twin.units import MM_PER_UM


@dataclass(frozen=True)
class Change:
    """Change of the machine's error field since the last accepted estimate, according to a new estimate (`found_um`),
    and the expected change (`expected_um`).

    Both values are rms values over the workspace in µm, after removal of the best-fitting rigid motion.
    """

    found_um: float
    expected_um: float


def night_noise(job: Job, model: ErrorModel) -> Array:
    """Return the standard deviation of the change of each of the p parameters of the error model in one night (24 h),
    as an array (p,) in mm or rad."""
    return expected_walk(job.machine.with_model(model), job.tool_offset_mm, job.settings.nightly)


def prior_tonight(job: Job, reference: ReferenceState, nights: float) -> CarriedOverPrior:
    """Return the estimate of the last accepted night, `reference`, as a prior for the identification of this night. Its
    uncertainty is increased by the drift that is expected in `nights` nights, of the size learned so far."""
    return reference.estimate.carried_over().after(night_noise(job, reference.estimate.model), nights)


def fit_of_night(
    job: Job, reference: ReferenceState, nights: float, observations: Observations, options: Options
) -> NightFit:
    """Return the comparison of the ball centres of a night with the last accepted night, `reference`, and the prior for
    their identification, with the size of the drift learned from them. `options` are those of the identification.

    Raises TwinError if the ball centres do not allow a comparison.
    """
    old = reference.estimate
    return compare_with_nights_before(
        job.machine.with_model(old.model).family,
        observations,
        job.artefact,
        old.carried_over(),
        night_noise(job, old.model),
        nights=nights,
        options=options,
        night_false_alarm=job.gate_limits.night_false_alarm,
    )


def change_since(
    job: Job, reference: ReferenceState, nights: float, estimate: Estimate, fused_with: CarriedOverPrior | None = None
) -> Change:
    """Return the change of the machine from the last accepted night, `reference`, to `estimate`.

    `fused_with` is the prior of `estimate` if it was made from the estimate of that night. In this case, the covariance
    of the expected difference between the two is the covariance of the prior minus the covariance of `estimate`. If the
    two estimates are independent (`fused_with` is None), the covariance of the expected difference is the sum of both
    covariances.
    """
    offset, old = job.tool_offset_mm, reference.estimate
    grid = evaluation_grid(old.model.ranges_mm)
    difference = _field(estimate.model, estimate.parameters, grid, offset)
    difference = difference - _field(old.model, old.parameters, grid, offset)
    prior = fused_with or prior_tonight(job, reference, nights)
    own = prior.unknowns.blocks.parameters
    drifted = prior.unknowns.physical_covariance(prior.covariance[own, own])
    before = _form(old.model, offset).expected(drifted).aligned_mm ** 2
    after = _form(estimate.model, offset).expected(estimate.covariance).aligned_mm ** 2
    expected = before + after if fused_with is None else max(before - after, 0.0)
    return Change(volumetric_error(grid + offset, difference).aligned_um, float(np.sqrt(expected)) / MM_PER_UM)


def _field(model: ErrorModel, parameters: Array, grid: Array, offset: Array) -> Array:
    return np.asarray(deviation_basis(model, grid, offset) @ parameters)


def _form(model: ErrorModel, offset: Array) -> QuadraticForm:
    return QuadraticForm.build(model, evaluation_grid(model.ranges_mm), offset)
