"""Deviation and predicted uncertainty over XY planes of the workspace, with the best rigid motion taken out."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from agent.report.map_figure import PlaneMap
from twin.identification import Estimate
from twin.machine_model import deviation_basis
from twin.rigid_motion import rigid_fields
from twin.volumetric import evaluation_grid

Array = NDArray[np.float64]

PLANE_SHAPE = (49, 25)
CHUNK = 2000
"""Grid points whose columns are held at a time."""


@dataclass(frozen=True)
class WorkspaceMaps:
    deviation: tuple[PlaneMap, ...]
    uncertainty: tuple[PlaneMap, ...]


def workspace_maps(estimate: Estimate, tool_offset: Array, measured: Array) -> WorkspaceMaps:
    """Maps at the bottom, the middle and the top of Z; `measured` (n, 3) axis positions go to the nearest plane."""
    fields = _AlignedFields(estimate, tool_offset)
    heights = np.linspace(*estimate.model.ranges_mm[2], 3)
    nearest = np.abs(measured[:, 2:] - heights).argmin(axis=1)
    deviation: list[PlaneMap] = []
    uncertainty: list[PlaneMap] = []
    for count, height in enumerate(heights):
        x, y, points = _plane(estimate, float(height))
        near = measured[nearest == count, :2]
        length, sigma = fields.at(points)
        for maps, values in ((deviation, length), (uncertainty, sigma)):
            maps.append(PlaneMap(float(height), x, y, 1e3 * values.reshape(PLANE_SHAPE), near))
    return WorkspaceMaps(tuple(deviation), tuple(uncertainty))


class _AlignedFields:
    """Columns of the field (parameters, then misfit modes) less the rigid motion that fits each best."""

    def __init__(self, estimate: Estimate, tool_offset: Array) -> None:
        self._estimate, self._offset = estimate, tool_offset
        points = evaluation_grid(estimate.model.ranges_mm)
        self._middle = points.mean(axis=0) + tool_offset
        self._size = float(np.ptp(points, axis=0).max())
        self._moments = _second_moments(estimate)
        self._motion = self._best_motions(points)

    def at(self, points: Array) -> tuple[Array, Array]:
        """Length (n,) of the estimated deviation and root mean square (n,) of what is not known of it, mm."""
        columns = self._columns(points) - self._rigid(points) @ self._motion
        size = self._estimate.model.size
        length = np.linalg.norm(columns[:, :, :size] @ self._estimate.parameters, axis=1)
        square = ((columns @ self._moments) * columns).sum(axis=(1, 2))
        return length, np.sqrt(np.maximum(square, 0.0))

    def _best_motions(self, points: Array) -> Array:
        """(6, columns): least squares over the grid that every volumetric error is stated on."""
        normal, shared = np.zeros((6, 6)), np.zeros((6, len(self._moments)))
        for start in range(0, len(points), CHUNK):
            chunk = points[start : start + CHUNK]
            rigid = self._rigid(chunk).reshape(-1, 6)
            normal += rigid.T @ rigid
            shared += rigid.T @ self._columns(chunk).reshape(len(rigid), -1)
        return np.asarray(np.linalg.solve(normal, shared), dtype=np.float64)

    def _columns(self, points: Array) -> Array:
        basis = deviation_basis(self._estimate.model, points, self._offset)
        misfit = self._estimate.misfit
        if misfit is None:
            return basis
        return np.concatenate((basis, misfit.amplitude_mm * misfit.modes.at(points)), axis=2)

    def _rigid(self, points: Array) -> Array:
        return rigid_fields(points + self._offset, self._middle, self._size)


def _second_moments(estimate: Estimate) -> Array:
    """Expected outer product of what is uncompensated: parameter errors and the misfit's coefficients."""
    misfit = estimate.misfit
    if misfit is None:
        return estimate.covariance
    expected = misfit.covariance + np.outer(misfit.coefficients, misfit.coefficients)
    cross = misfit.cross_covariance
    return np.block([[estimate.covariance, cross], [cross.T, expected]])


def _plane(estimate: Estimate, height: float) -> tuple[Array, Array, Array]:
    ranges = estimate.model.ranges_mm[:2]
    x, y = (np.linspace(*limits, count) for limits, count in zip(ranges, PLANE_SHAPE, strict=True))
    grid = np.stack(np.meshgrid(x, y, [height], indexing="ij"), axis=-1).reshape(-1, 3)
    return x, y, grid
