"""Predicted accuracy of the compensated machine, before a compensation table is written to its controller."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from twin.arrays import Array, as_points, as_vector
from twin.artefact.certificate import without_motions
from twin.identification.estimate import Misfit
from twin.identification.unknowns import Unknowns
from twin.machine.error_model import ErrorModel
from twin.machine.forward_model import deviation_basis
from twin.machine.grid_quadrature import GridQuadrature
from twin.machine.rigid_motion import rigid_fields
from twin.machine.volumetric import VolumetricRms

_CHUNK = 500  # points whose basis is held in memory at a time


class FieldKnowledge(Protocol):
    """Interface of an estimate, computed or stored, with the properties needed to predict the error field that remains
    after compensation."""

    @property
    def model(self) -> ErrorModel: ...
    @property
    def covariance(self) -> Array: ...
    @property
    def misfit(self) -> Misfit | None: ...


def predicted_vce(estimate: FieldKnowledge, points: ArrayLike, tool_offset: ArrayLike) -> VolumetricRms:
    """Return the predicted volumetric compensated error (VCE, the error that remains after compensation) over axis
    positions (n, 3), both before and after the best-fitting rigid motion has been removed.

    Each value is the root of an expected mean square of the true minus the modelled deviation. The posterior
    expectation includes the covariance of the parameters, and the expected value and the covariance of the misfit.
    """
    grid, offset = as_points(points, "points"), as_vector(tool_offset, 3, "tool offset")
    return expected_vce(estimate, field_forms(estimate, grid, offset))


def expected_vce(estimate: FieldKnowledge, forms: tuple[Array, Array]) -> VolumetricRms:
    """Return the error that `predicted_vce` returns, from the two quadratic forms that `field_forms` returns."""
    moments = _second_moments(estimate)
    beside = 3.0 * unresolved_variance(estimate)
    raw, left = (float(np.vdot(form, moments)) + beside for form in forms)
    return VolumetricRms(float(np.sqrt(max(raw, 0.0))), float(np.sqrt(max(left, 0.0))))


def field_uncertainty(
    estimate: FieldKnowledge, points: ArrayLike, tool_offset: ArrayLike, aligned_over: ArrayLike | None = None
) -> Array:
    """Return the posterior rms (n, 3) in mm, per direction, of the true minus the modelled tool point deviation at axis
    positions (n, 3).

    If `aligned_over` (m, 3) is given, the best-fitting rigid motion over these m axis positions is removed first.
    """
    at, offset = as_points(points, "points"), as_vector(tool_offset, 3, "tool offset")
    moments = _second_moments(estimate)
    grid = at if aligned_over is None else as_points(aligned_over, "points of the alignment")
    motions = _motions_about(grid, offset)
    carried = np.zeros((6, len(moments))) if aligned_over is None else field_sums(estimate, grid, offset).share
    squares = np.empty_like(at)
    for start in range(0, len(at), _CHUNK):
        chunk = at[start : start + _CHUNK]
        field = field_columns(estimate, chunk, offset) - motions(chunk) @ carried
        squares[start : start + _CHUNK] = np.einsum("nip,nip->ni", field @ moments, field)
    return np.sqrt(np.maximum(squares, 0.0) + unresolved_variance(estimate))


def residual_covariance(
    estimate: FieldKnowledge, points: ArrayLike, tool_offset: ArrayLike, aligned_over: ArrayLike | None = None
) -> Array:
    """Return the expected outer product (3n, 3n) in mm² of the true minus the modelled tool point deviation at axis
    positions (n, 3). Rows and columns are ordered point by point, with x, y and z of each point in this order.

    If `aligned_over` (m, 3) is given, the best-fitting rigid motion over these m axis positions is removed first.
    """
    at, offset = as_points(points, "points"), as_vector(tool_offset, 3, "tool offset")
    moments = _second_moments(estimate)
    field = field_columns(estimate, at, offset)
    if aligned_over is not None:
        grid = as_points(aligned_over, "points of the alignment")
        field = field - _motions_about(grid, offset)(at) @ field_sums(estimate, grid, offset).share
    columns = field.reshape(-1, len(moments))
    return np.asarray(columns @ moments @ columns.T) + unresolved_variance(estimate) * np.eye(len(columns))


def shared_with_artefact(unknowns: Unknowns, z_covariance: Array, points: ArrayLike, tool_offset: ArrayLike) -> Array:
    """Return the covariance (3n, 3N) in mm² of the true minus the modelled tool point deviation at axis positions (n,
    3) with the errors of the N ball centres that the same estimate found for the artefact.

    `z_covariance` (P, P) is the covariance of the P `unknowns`. Rigid motions of the artefact are removed, as in its
    calibration.
    """
    grid, offset = as_points(points, "points"), as_vector(tool_offset, 3, "tool offset")
    blocks, modes, errors = unknowns.blocks, unknowns.modes, unknowns.artefact
    basis = deviation_basis(unknowns.model, grid, offset)
    shared = (basis * unknowns.scale).reshape(grid.size, -1) @ z_covariance[blocks.parameters, blocks.certificate]
    if modes is not None:
        at_hand = basis if (offset == modes.tool_offset).all() else None
        fields = unknowns.misfit_mm * modes.at(grid, at_hand)
        shared += fields.reshape(grid.size, -1) @ z_covariance[blocks.misfit, blocks.certificate]
    return np.asarray(shared @ errors.certificate.T @ without_motions(errors.balls))


def field_forms(estimate: FieldKnowledge, points: Array, offset: Array) -> tuple[Array, Array]:
    """Return two quadratic forms (p + q, p + q) in mm² that give the mean square of the error field of `estimate` over
    axis positions (n, 3).

    The forms apply to a vector of the p parameters followed by the q coefficients of the misfit. The first form is for
    the field as it is. The second form is for the field after the best-fitting rigid motion has been removed.
    """
    return field_sums(estimate, points, offset).forms


def regional_forms(
    estimate: FieldKnowledge,
    points: ArrayLike,
    inside: NDArray[np.bool_],
    tool_offset: ArrayLike,
    sums: FieldSums | None = None,
) -> tuple[Array | None, Array | None]:
    """Return two quadratic forms (p + q, p + q) in mm² that give the mean square of the error field of `estimate` in
    two parts of the workspace: over those axis positions (n, 3) for which the mask `inside` (n,) is True, and over the
    others. A form is None if its part has no axis position.

    As in `field_forms`, the forms apply to the p parameters followed by the q coefficients of the misfit. The rigid
    motion that fits the field best over all n axis positions is removed first. Therefore the mean square over all
    positions is the mean of the two forms, weighted by the numbers of positions. `sums` are those that `field_sums`
    returns for all n axis positions; they are computed if they are None.
    """
    grid, offset = as_points(points, "points"), as_vector(tool_offset, 3, "tool offset")
    sums = field_sums(estimate, grid, offset) if sums is None else sums
    whole = sums.forms[1]
    motions, share = _motions_about(grid, offset), sums.share
    count, fewer = len(grid), bool(2 * inside.sum() <= len(grid))
    part = grid[inside if fewer else ~inside]
    gram = np.zeros_like(whole)
    for start in range(0, len(part), _CHUNK):
        chunk = part[start : start + _CHUNK]
        field = (field_columns(estimate, chunk, offset) - motions(chunk) @ share).reshape(-1, len(whole))
        gram += field.T @ field
    # the sum over the other part follows from the sum over all, which the quadrature gives from few nodes
    first = None if len(part) == 0 else gram / len(part)
    second = None if len(part) == count else (count * whole - gram) / (count - len(part))
    return (first, second) if fewer else (second, first)


def expected_rms(estimate: FieldKnowledge, form: Array) -> float:
    """Return the root in mm of the expected mean square of the true minus the modelled deviation. `form` is a quadratic
    form (p + q, p + q) of the error field, as `field_forms` and `regional_forms` return it."""
    square = float(np.vdot(form, _second_moments(estimate))) + 3.0 * unresolved_variance(estimate)
    return float(np.sqrt(max(square, 0.0)))


@dataclass(frozen=True, eq=False)
class FieldSums:
    """Sums, over a grid of `count` points, of products of the columns F of the error field and the fields G of the
    rigid motions.

    `field` is FᵀF, `shared` is GᵀF, and `motion` is GᵀG.
    """

    field: Array
    shared: Array
    motion: Array
    count: int

    @property
    def forms(self) -> tuple[Array, Array]:
        """Quadratic forms that `field_forms` returns."""
        # remove the best rigid motion G: FᵀF - FᵀG (GᵀG)⁻¹ GᵀF
        rigid = self.shared.T @ self.share
        return self.field / self.count, (self.field - 0.5 * (rigid + rigid.T)) / self.count

    @property
    def share(self) -> Array:
        """Coefficients (6, p + q) of the rigid motions that each column contains."""
        return np.asarray(np.linalg.lstsq(self.motion, self.shared, rcond=1e-12)[0])


def field_sums(estimate: FieldKnowledge, grid: Array, offset: Array) -> FieldSums:
    """Return the sums of the error field of `estimate` over the axis positions `grid` (n, 3) in mm, for a tool offset
    (3,) in mm. All quadratic forms over this grid follow from them."""
    motions = _motions_about(grid, offset)
    sums = GridQuadrature.for_points(grid, field_degrees(estimate))
    size = len(_second_moments(estimate))
    field_sum, shared, motion = np.zeros((size, size)), np.zeros((6, size)), np.zeros((6, 6))
    for start in range(0, len(sums.nodes), _CHUNK):
        chunk = sums.nodes[start : start + _CHUNK]
        roots = np.sqrt(sums.weights[start : start + _CHUNK]).repeat(3)[:, None]
        field = roots * field_columns(estimate, chunk, offset).reshape(-1, size)
        rigid = roots * motions(chunk).reshape(-1, 6)
        field_sum += field.T @ field
        shared += rigid.T @ field
        motion += rigid.T @ rigid
    return FieldSums(field_sum, shared, motion, len(grid))


def field_degrees(estimate: FieldKnowledge) -> tuple[int, int, int]:
    """Return upper bounds of the powers of x, y and z in the columns of the field. A column is a Legendre series with a
    lever, a cross-effect with a lever, or a misfit mode."""
    modes = () if estimate.misfit is None else estimate.misfit.modes.degrees
    x, y, z = (
        max(highest, *(degrees[axis] for degrees in modes), 0)
        for axis, highest in enumerate(estimate.model.field_degrees)
    )
    return x, y, z


def _motions_about(grid: Array, offset: Array) -> Callable[[Array], Array]:
    """Return a function that takes axis positions and returns the fields of the rigid motions at these positions. The
    rotations are about the middle of the grid's tool points."""
    middle, size_mm = grid.mean(axis=0) + offset, max(float(np.ptp(grid, axis=0).max()), 1.0)
    return lambda points: rigid_fields(points + offset, middle, size_mm)


def _second_moments(estimate: FieldKnowledge) -> Array:
    """Return the expected outer product (p + q, p + q) of a vector with two parts: the true minus the estimated
    parameters (p,), and the true misfit coefficients (q,)."""
    misfit = estimate.misfit
    if misfit is None:
        return estimate.covariance
    expected = misfit.covariance + np.multiply.outer(misfit.coefficients, misfit.coefficients)
    return np.block([[estimate.covariance, misfit.cross_covariance], [misfit.cross_covariance.T, expected]])


def unresolved_variance(estimate: FieldKnowledge) -> float:
    """Return the variance (mm²) per direction of the part of the misfit whose wavelength is too short for its modes.
    This part is uncorrelated between points."""
    return 0.0 if estimate.misfit is None else estimate.misfit.unresolved_mm2


def field_columns(estimate: FieldKnowledge, points: Array, offset: Array) -> Array:
    """Return the error field (n, 3, p + q) in mm that one unit of each of the p parameters and q misfit coefficients
    causes at the axis positions `points` (n, 3)."""
    basis = deviation_basis(estimate.model, points, offset)
    misfit = estimate.misfit
    if misfit is None:
        return basis
    at_hand = basis if (offset == misfit.modes.tool_offset).all() else None
    return np.concatenate((basis, misfit.amplitude_mm * misfit.modes.at(points, at_hand)), axis=2)
