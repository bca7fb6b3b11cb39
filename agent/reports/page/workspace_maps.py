"""Maps of the machine's deviation and of its uncertainty over XY planes of the workspace, after removal of the
best-fitting rigid motion."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from agent.reports.page.data import ReportedEstimate
from twin.arrays import Array
from twin.identification import field_uncertainty
from twin.machine.forward_model import exact_deviation
from twin.machine.volumetric import evaluation_grid, rigid_part

PLANE_SHAPE = (49, 25)


@dataclass(frozen=True)
class PlaneMap:
    """Map of the length of an error vector in µm over an XY plane at the height `z_mm`.

    `length_um` (nx, ny) contains the length of the vector at each point of the grid with the nx coordinates `x_mm`
    and the ny coordinates `y_mm`. `measured` (m, 2) contains X and Y in mm of the m balls that are nearer to this
    plane than to the other planes."""

    z_mm: float
    x_mm: Array
    y_mm: Array
    length_um: Array
    measured: Array


@dataclass(frozen=True)
class WorkspaceMaps:
    deviation: tuple[PlaneMap, ...]
    uncertainty: tuple[PlaneMap, ...]


def workspace_maps(estimate: ReportedEstimate, tool_offset: Array, measured: Array) -> WorkspaceMaps:
    """Return maps of the machine's deviation and of its uncertainty, at the lower end, the middle and the upper end of
    the Z travel.

    `measured` (n, 3) contains the axis positions of the n balls in mm. Each ball is shown on the nearest plane.
    """
    heights = np.linspace(*estimate.model.ranges_mm[2], 3)
    planes = [_plane(estimate, float(height)) for height in heights]
    points = np.concatenate([plane_points for _, _, plane_points in planes])
    # remove the rigid motion fitted on the evaluation grid, to which every volumetric error refers
    grid = evaluation_grid(estimate.model.ranges_mm)
    found, everywhere = (exact_deviation(estimate.model, at, tool_offset, estimate.parameters) for at in (points, grid))
    left = found - rigid_part(grid + tool_offset, everywhere, points + tool_offset)
    unknown = field_uncertainty(estimate, points, tool_offset, aligned_over=grid)
    nearest = np.abs(measured[:, 2:] - heights).argmin(axis=1)

    def maps(field: Array) -> tuple[PlaneMap, ...]:
        lengths_um = 1e3 * np.linalg.norm(field, axis=1).reshape(len(heights), *PLANE_SHAPE)
        return tuple(
            PlaneMap(float(height), x, y, lengths_um[count], measured[nearest == count, :2])
            for count, (height, (x, y, _)) in enumerate(zip(heights, planes, strict=True))
        )

    return WorkspaceMaps(maps(left), maps(unknown))


def _plane(estimate: ReportedEstimate, height: float) -> tuple[Array, Array, Array]:
    ranges = estimate.model.ranges_mm[:2]
    x, y = (np.linspace(*limits, count) for limits, count in zip(ranges, PLANE_SHAPE, strict=True))
    grid = np.stack(np.meshgrid(x, y, [height], indexing="ij"), axis=-1).reshape(-1, 3)
    return x, y, grid
