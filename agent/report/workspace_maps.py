"""Deviation and predicted uncertainty over XY planes of the workspace, with the best rigid motion taken out."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from agent.report.map_figure import PlaneMap
from twin.error_model import ErrorModel
from twin.machine_model import deviation_basis

Array = NDArray[np.float64]

PLANE_SHAPE = (49, 25)
GAUGE_SHAPE = (13, 7, 7)
"""Nodes over which the rigid motion is fitted: it is smooth, a coarse grid gives it to the map's own accuracy."""


@dataclass(frozen=True)
class WorkspaceMaps:
    deviation: tuple[PlaneMap, ...]
    uncertainty: tuple[PlaneMap, ...]


def workspace_maps(
    model: ErrorModel, tool_offset: Array, parameters: Array, covariance: Array, measured: Array
) -> WorkspaceMaps:
    """Maps at the bottom, the middle and the top of Z; `measured` (n, 3) axis positions go to the nearest plane."""
    motion = _rigid_motions(model, tool_offset)
    spread = np.linalg.cholesky(covariance + _nothing(covariance))
    heights = np.linspace(*model.ranges_mm[2], 3)
    nearest = np.abs(measured[:, 2:] - heights).argmin(axis=1)
    deviation, uncertainty = [], []
    for count, height in enumerate(heights):
        x, y, points = _plane(model, float(height))
        basis = _aligned_basis(model, points, tool_offset, motion)
        near = measured[nearest == count, :2]
        length = np.linalg.norm(basis @ parameters, axis=1)
        sigma = np.linalg.norm((basis @ spread).reshape(len(points), -1), axis=1)
        for maps, values in ((deviation, length), (uncertainty, sigma)):
            maps.append(PlaneMap(float(height), x, y, 1e3 * values.reshape(PLANE_SHAPE), near))
    return WorkspaceMaps(tuple(deviation), tuple(uncertainty))


def _nothing(covariance: Array) -> Array:
    """A diagonal far below anything measured that makes a singular covariance factorable."""
    return np.diag(1e-12 * np.diag(covariance) + 1e-24)


def _plane(model: ErrorModel, height: float) -> tuple[Array, Array, Array]:
    x, y = (np.linspace(*limits, count) for limits, count in zip(model.ranges_mm[:2], PLANE_SHAPE, strict=True))
    grid = np.stack(np.meshgrid(x, y, [height], indexing="ij"), axis=-1).reshape(-1, 3)
    return x, y, grid


def _rigid_motions(model: ErrorModel, tool_offset: Array) -> Array:
    """(6, p): the rigid motion, by least squares over the workspace, of each parameter's field."""
    lines = [np.linspace(*limits, count) for limits, count in zip(model.ranges_mm, GAUGE_SHAPE, strict=True)]
    points = np.stack(np.meshgrid(*lines, indexing="ij"), axis=-1).reshape(-1, 3)
    basis = deviation_basis(model, points, tool_offset)
    columns = _rigid_basis(model, points).reshape(-1, 6)
    return np.linalg.lstsq(columns, basis.reshape(-1, model.size))[0]


def _aligned_basis(model: ErrorModel, points: Array, tool_offset: Array, motion: Array) -> Array:
    return deviation_basis(model, points, tool_offset) - _rigid_basis(model, points) @ motion


def _rigid_basis(model: ErrorModel, points: Array) -> Array:
    """(n, 3, 6): three translations and three small rotations about the middle, scaled to metres."""
    arm = 1e-3 * (points - np.mean(model.ranges_mm, axis=1))
    rigid = np.zeros((len(points), 3, 6))
    rigid[:, [0, 1, 2], [0, 1, 2]] = 1.0
    for axis in range(3):
        rigid[:, :, 3 + axis] = np.cross(np.eye(3)[axis], arm)
    return rigid
