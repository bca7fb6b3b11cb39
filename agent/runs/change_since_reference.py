"""How a machine may change between two nights, and how far an estimate says that it has."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from agent.planning.job import Job
from agent.runs.reference_state import ReferenceState
from twin.arrays import Array
from twin.identification import CarriedOverPrior, Estimate, process_noise
from twin.machine.error_model import ErrorModel
from twin.machine.forward_model import deviation_basis
from twin.machine.volumetric import QuadraticForm, evaluation_grid, volumetric_error
from twin.units import MM_PER_UM

SCALES = ("EXX[1]", "EYY[1]", "EZZ[1]")


@dataclass(frozen=True)
class Change:
    """Rms field over the workspace, aligned, µm: by how much it has changed, and by how much it was expected to."""

    found_um: float
    expected_um: float


def night_noise(job: Job, model: ErrorModel) -> Array:
    """(p,) standard deviations (mm or rad) by which each parameter may change in one night."""
    chosen = job.settings.nightly
    family = job.machine.with_model(model).family
    noise = process_noise(family, MM_PER_UM * chosen.drift_um, job.tool_offset_mm)
    for name, (low, high) in zip(SCALES, model.ranges_mm, strict=True):
        place = model.names.index(name)
        noise[place] = np.hypot(noise[place], 0.5e-6 * chosen.scale_drift_um_per_m * (high - low))
    return noise


def prior_tonight(job: Job, reference: ReferenceState, nights: float) -> CarriedOverPrior:
    """What the last accepted night knows, grown older by `nights`."""
    return reference.estimate.carried_over().after(night_noise(job, reference.estimate.model), nights)


def change_since(
    job: Job, reference: ReferenceState, nights: float, estimate: Estimate, *, fused: bool = False
) -> Change:
    """From what the last accepted night knew to `estimate`, which has taken that for its prior (`fused`) or nothing.

    What an estimate learns beyond its prior is as large as the prior's covariance less its own; two estimates that know
    nothing of each other differ by the sum of theirs.
    """
    offset, old = job.tool_offset_mm, reference.estimate
    grid = evaluation_grid(old.model.ranges_mm)
    difference = _field(estimate.model, estimate.parameters, grid, offset)
    difference = difference - _field(old.model, old.parameters, grid, offset)
    drift = np.diag(night_noise(job, old.model) ** 2 * nights)
    before = _form(old.model, offset).expected(old.covariance + drift).aligned_mm ** 2
    after = _form(estimate.model, offset).expected(estimate.covariance).aligned_mm ** 2
    expected = max(before - after, 0.0) if fused else before + after
    return Change(volumetric_error(grid + offset, difference).aligned_um, float(np.sqrt(expected)) / MM_PER_UM)


def _field(model: ErrorModel, parameters: Array, grid: Array, offset: Array) -> Array:
    return np.asarray(deviation_basis(model, grid, offset) @ parameters)


def _form(model: ErrorModel, offset: Array) -> QuadraticForm:
    return QuadraticForm.build(model, evaluation_grid(model.ranges_mm), offset)
