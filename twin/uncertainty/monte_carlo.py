"""Monte Carlo simulation of a whole calibration procedure: true machine, true artefact, simulated measurements,
residual error.

Every quantity that `twin.identification` models as uncertain is drawn at random here. The machine is drawn from its
family, which may have any Legendre order and a deflection; its parameters are uniformly distributed. The artefact is
drawn from its certificate. The errors of thermometer, drift, touches and further effects are drawn from their
uncertainties. The true field is computed from the exact product of the axis transforms, not from its linearisation.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from twin.arrays import Array
from twin.artefact.artefact import Artefact
from twin.artefact.observations import Observations
from twin.identification.estimate import Estimate
from twin.machine.true_machine import TrueMachine
from twin.machine.volumetric import VolumetricRms
from twin.uncertainty.residual_field_form import FieldForm
from twin.uncertainty.truth_assumptions import TruthAssumptions

IndexArray = np.ndarray[Any, np.dtype[np.int64]]

_STEPS = 3
"""Steps of the fixed-point iteration. Each reduces the error, initially about 0.1 mm, by a factor of at least 1e4."""


def draw_truth(assumptions: TruthAssumptions, rng: np.random.Generator, tool_offset: ArrayLike) -> TrueMachine:
    """Draw one true machine at random from the family of machines in `assumptions`.

    The machine has the deflection that all machines of this family share.
    """
    family = assumptions.family
    offset = np.asarray(tool_offset, dtype=np.float64)
    return TrueMachine(family.model, family.draw(rng, 1)[0], offset, assumptions.deflection)


@dataclass(frozen=True, eq=False)
class TrueArtefact:
    """True artefact, and the error in K of its thermometer, which is positive if the thermometer reads too high."""

    artefact: Artefact
    thermometer_error_k: float


def simulated_observations(
    planned: Observations,
    artefact: Artefact,
    truth: TrueMachine,
    assumptions: TruthAssumptions,
    rng: np.random.Generator,
    true_artefact: TrueArtefact | None = None,
) -> Observations:
    """Simulate the measurement of the `planned` balls on the machine `truth`, and return the observations.

    `planned` contains the observations that an error-free machine would give at the same balls. `artefact` is the
    artefact with its certified values; the true one is drawn unless it is given as `true_artefact`. Random numbers are
    drawn even for an influence (such as touch noise) that `assumptions` switch off, so the values of the other
    influences do not depend on what is switched off.
    """
    real = true_artefact or draw_artefact(artefact, assumptions, rng)
    change = _ball_displacements(planned, artefact, real.artefact, assumptions.artefact_temperature_c)
    found = _measured_positions(planned, truth, planned.axis_positions + change)
    found += _draw_drift(planned.position, assumptions.drift_mm, rng)
    touches = _touch_noise(planned.covariance, rng)
    if assumptions.touch_noise:
        found += touches
    for effect in assumptions.effects:
        fields = effect.fields(assumptions.family.model, planned)
        found += fields @ rng.standard_normal(fields.shape[2])
    # The balls are at the true temperature, but the observations state what the thermometer shows.
    shown_c = np.full(planned.size, assumptions.artefact_temperature_c + real.thermometer_error_k)
    return replace(planned, axis_positions=found, temperature_c=shown_c)


def uncompensated_errors(form: FieldForm, truths: Array) -> tuple[Array, Array]:
    """Return the volumetric errors (VE) of m machines in mm, raw and aligned, as two arrays of shape (m,).

    Aligned means after the best-fitting rigid motion has been removed. `truths`, shape (m, t), contains the t
    parameters of each machine in the model of the true machines.
    """
    return form.form.values(_embed(form, truths, form.true_indices))


def compensated_errors(form: FieldForm, truths: Array, estimates: Array) -> tuple[Array, Array]:
    """Return the volumetric compensated errors (VCE) of m machines in mm, raw and aligned, as two arrays of shape (m,).

    Aligned means after the best-fitting rigid motion has been removed. `truths`, shape (m, t), contains the t true
    parameters of each machine; `estimates`, shape (m, p), contains the p model parameters of its compensation.
    """
    return form.form.values(_embed(form, truths, form.true_indices) - _embed(form, estimates, form.model_indices))


def true_vce(estimate: Estimate, truth: TrueMachine, form: FieldForm) -> VolumetricRms:
    """Return the volumetric error that remains on the machine `truth` after compensation.

    The compensation uses the parameters of `estimate`.
    """
    raw, aligned = compensated_errors(form, truth.parameters[None, :], estimate.parameters[None, :])
    return VolumetricRms(float(raw[0]), float(aligned[0]))


def _embed(form: FieldForm, parameters: Array, indices: IndexArray) -> Array:
    """Insert parameters (m, ...) at `indices` into zero vectors (m, u) of the joint model."""
    vectors = np.zeros((len(parameters), form.size))
    vectors[:, indices] = parameters
    return vectors


def draw_artefact(artefact: Artefact, assumptions: TruthAssumptions, rng: np.random.Generator) -> TrueArtefact:
    """Draw the true artefact with the certified values of `artefact`, and the error of its thermometer."""
    off_mm = _factor(artefact.covariance) @ rng.standard_normal(3 * artefact.count)
    off_per_k = artefact.cte_standard_uncertainty_per_k * rng.standard_normal()
    shift_k = assumptions.thermometer_uncertainty_k * rng.standard_normal()
    real = replace(
        artefact,
        balls=artefact.balls + assumptions.certificate * off_mm.reshape(-1, 3),
        cte_per_k=artefact.cte_per_k + assumptions.cte * off_per_k,
    )
    return TrueArtefact(real, float(shift_k))


def _ball_displacements(planned: Observations, stated: Artefact, real: Artefact, temperature_c: float) -> Array:
    """Return the displacements (n, 3) in mm of the true balls from their planned points. Components are along the
    machine axes."""
    local = np.empty((planned.size, 3))
    for elevation in np.unique(planned.elevation_rad):
        rows = planned.elevation_rad == elevation
        local[rows] = (real.at(temperature_c, float(elevation)) - stated.balls)[planned.ball[rows]]
    return np.asarray(np.einsum("nij,nj->ni", _orientation(planned, stated), local))


def _orientation(planned: Observations, stated: Artefact) -> Array:
    """Return the rotation (n, 3, 3) from the artefact's frame to the machine's frame at each row.

    The rotation is Rz(azimuth) Ry(-elevation). The elevation is known. The azimuth is the one that best fits the
    artefact to the planned points. This also gives the correct roll about a straight bar, which a fit of its balls
    cannot determine.
    """
    sine, cosine = np.sin(planned.elevation_rad), np.cos(planned.elevation_rad)
    zero, one = np.zeros_like(sine), np.ones_like(sine)
    raised = _matrices((cosine, zero, -sine), (zero, one, zero), (sine, zero, cosine))
    points = planned.axis_positions + planned.tool_offsets[planned.tool]
    found = _about_centroid(points, planned.position)
    laid = _about_centroid(np.einsum("nij,nj->ni", raised, stated.balls[planned.ball]), planned.position)
    group = np.unique(planned.position, return_inverse=True)[1]
    # azimuth of the best fit in the XY plane: tan = Σ (laid × found)_z / Σ laid · found
    across = np.bincount(group, laid[:, 0] * found[:, 1] - laid[:, 1] * found[:, 0])
    along = np.bincount(group, laid[:, 0] * found[:, 0] + laid[:, 1] * found[:, 1])
    azimuth = np.arctan2(across, along)[group]
    sine, cosine = np.sin(azimuth), np.cos(azimuth)
    return np.asarray(_matrices((cosine, -sine, zero), (sine, cosine, zero), (zero, zero, one)) @ raised)


def _matrices(*rows: tuple[Array, Array, Array]) -> Array:
    return np.moveaxis(np.array(rows), 2, 0)


def _about_centroid(points: Array, position: IndexArray) -> Array:
    """Return points (n, 3) minus the mean of the points of the same position."""
    group, counts = np.unique(position, return_inverse=True, return_counts=True)[1:]
    sums = np.column_stack([np.bincount(group, points[:, axis]) for axis in range(3)])
    return np.asarray(points - (sums / counts[:, None])[group])


def _measured_positions(planned: Observations, truth: TrueMachine, wanted: Array) -> Array:
    """Solve X + d(X) = wanted for the axis positions X (n, 3) at which the tool point reaches `wanted`."""
    found = wanted.copy()
    for tool in np.unique(planned.tool):
        rows = planned.tool == tool
        machine = replace(truth, tool_offset=planned.tool_offsets[tool])
        at = wanted[rows]
        for _ in range(_STEPS):  # fixed point X ← wanted - d(X); d changes by less than 1e-4 of a change of X
            at = wanted[rows] - machine.deviation(at)
        found[rows] = at
    return found


def _draw_drift(position: IndexArray, drift_mm: float, rng: np.random.Generator) -> Array:
    """Return the drift (n, 3) in mm of each row. In each position it grows linearly from zero at the first ball to a
    random vector at the last one."""
    group, counts = np.unique(position, return_inverse=True, return_counts=True)[1:]
    ends = drift_mm * rng.standard_normal((len(counts), 3))
    return np.asarray(position_progress(position)[:, None] * ends[group])


def position_progress(position: IndexArray) -> Array:
    """Return the progress, shape (n,), of each of n measured balls within its position of the artefact.

    The progress rises linearly from 0 at the first ball of the position to 1 at the last. `position`, shape (n,),
    contains the number of the position to which each ball belongs.
    """
    group, counts = np.unique(position, return_inverse=True, return_counts=True)[1:]
    order = np.argsort(group, kind="stable")
    rank = np.empty(len(group))
    rank[order] = np.arange(len(group)) - np.repeat(np.cumsum(counts) - counts, counts)
    return np.asarray(rank / np.maximum(counts - 1, 1)[group])


def _touch_noise(covariance: Array, rng: np.random.Generator) -> Array:
    """Draw noise (n, 3) in mm with covariances (n, 3, 3)."""
    factors = np.linalg.cholesky(covariance)
    return np.asarray(np.einsum("nij,nj->ni", factors, rng.standard_normal((len(covariance), 3))))


def _factor(covariance: Array) -> Array:
    """Return a matrix L with L Lᵀ = `covariance`, which may be singular. Repeated calls give the same L."""
    diagonal = np.diagonal(covariance)
    if np.count_nonzero(covariance) == np.count_nonzero(diagonal):
        return np.diag(np.sqrt(diagonal))
    values, vectors = np.linalg.eigh(covariance)
    factor: Array = vectors * np.sqrt(np.maximum(values, 0.0))
    return factor
