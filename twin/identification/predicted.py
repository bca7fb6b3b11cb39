"""What the compensated machine will be worth, before anything is written."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from twin.arrays import Array, as_points, as_vector
from twin.identification.estimate import Estimate
from twin.machine_model import deviation_basis
from twin.rigid_motion import rigid_fields
from twin.volumetric import Volumetric

_CHUNK = 2000  # points whose basis is held at a time


def predicted_vce(estimate: Estimate, points: ArrayLike, tool_offset: ArrayLike) -> Volumetric:
    """Predicted volumetric compensated error at axis positions (n, 3): root of the expected mean square, over the
    posterior, of machine less model; raw and after the best rigid motion.

    Holds the covariance of the parameters and all that is known of the misfit: expected value and covariance.
    """
    grid, offset = as_points(points, "points"), as_vector(tool_offset, 3, "tool offset")
    moments = _second_moments(estimate)
    middle, size_mm = grid.mean(axis=0) + offset, max(float(np.ptp(grid, axis=0).max()), 1.0)
    gram, shared, motion = np.zeros(moments.shape), np.zeros((6, len(moments))), np.zeros((6, 6))
    for start in range(0, len(grid), _CHUNK):
        chunk = grid[start : start + _CHUNK]
        field = _columns(estimate, chunk, offset).reshape(-1, len(moments))
        rigid = rigid_fields(chunk + offset, middle, size_mm).reshape(-1, 6)
        gram += field.T @ field
        shared += rigid.T @ field
        motion += rigid.T @ rigid
    aligned = gram - shared.T @ np.linalg.lstsq(motion, shared, rcond=1e-12)[0]
    return Volumetric(_root_mean(gram, moments, len(grid)), _root_mean(aligned, moments, len(grid)))


def field_uncertainty(estimate: Estimate, points: ArrayLike, tool_offset: ArrayLike) -> Array:
    """Posterior root mean square (n, 3) mm of machine less model at axis positions (n, 3), per direction, raw."""
    grid, offset = as_points(points, "points"), as_vector(tool_offset, 3, "tool offset")
    moments = _second_moments(estimate)
    squares = np.empty_like(grid)
    for start in range(0, len(grid), _CHUNK):
        field = _columns(estimate, grid[start : start + _CHUNK], offset)
        squares[start : start + _CHUNK] = np.einsum("nip,nip->ni", field @ moments, field)
    return np.sqrt(np.maximum(squares, 0.0))


def _second_moments(estimate: Estimate) -> Array:
    """Expected outer product of (true less estimated parameters, true misfit coefficients)."""
    misfit = estimate.misfit
    if misfit is None:
        return estimate.covariance
    expected = misfit.covariance + np.multiply.outer(misfit.coefficients, misfit.coefficients)
    return np.block([[estimate.covariance, misfit.cross_covariance], [misfit.cross_covariance.T, expected]])


def _columns(estimate: Estimate, points: Array, offset: Array) -> Array:
    """(n, 3, p + q) mm per parameter and per misfit coefficient."""
    basis = deviation_basis(estimate.model, points, offset)
    misfit = estimate.misfit
    if misfit is None:
        return basis
    at_hand = basis if (offset == misfit.modes.tool_offset).all() else None
    return np.concatenate((basis, misfit.amplitude_mm * misfit.modes.at(points, at_hand)), axis=2)


def _root_mean(gram: Array, moments: Array, count: int) -> float:
    return float(np.sqrt(max(float(np.einsum("ij,ji->", gram, moments)), 0.0) / count))
