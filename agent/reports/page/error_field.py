"""Error field of a machine without and with the compensation table of a run, on any plane of the workspace."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from agent.reports.page.data import ReportedEstimate
from agent.reports.page.workspace_maps import PLANE_SHAPE
from twin.arrays import Array
from twin.compensation.table import CompensationTable
from twin.identification import field_uncertainty
from twin.machine.forward_model import exact_deviation
from twin.machine.volumetric import evaluation_grid, rigid_part
from twin.units import UM_PER_MM

if TYPE_CHECKING:
    from scipy.interpolate import RegularGridInterpolator

_LATTICE = (25, 13, 13)
"""Points per axis at which the uncertainty is computed once per run; between them it is interpolated."""


@dataclass(frozen=True, eq=False)
class FieldPlane:
    """Error field on the plane at the position `at_mm` of the axis `normal` (0, 1, 2 for X, Y, Z).

    `across` are the two other axes and `nodes_mm` the n and m positions along them. `without_um` (n, m, 3) is the
    deviation of the machine without compensation as the run identified it, and `with_um` what is left of it with the
    table that the run wrote, None if it wrote none; both after removal of the best-fitting rigid motion. `sigma_um` (n,
    m) is the standard uncertainty of the length of both. `measured` (k, 3) contains the positions along the two axes of
    the k measured balls, and their distance in mm from the plane.
    """

    normal: int
    at_mm: float
    across: tuple[int, int]
    nodes_mm: tuple[Array, Array]
    without_um: Array
    with_um: Array | None
    sigma_um: Array
    measured: Array


@dataclass(frozen=True, eq=False)
class ErrorField:
    """Error field that a run identified. `tool_offset_mm` (3,) is the tool to which it refers, `measured_mm` (n, 3) are
    the axis positions of the measured balls, and `table` is the table that the run wrote, or None."""

    estimate: ReportedEstimate
    tool_offset_mm: Array
    measured_mm: Array
    table: CompensationTable | None

    @property
    def ranges_mm(self) -> tuple[tuple[float, float], ...]:
        return tuple((float(low), float(high)) for low, high in self.estimate.model.ranges_mm)

    @cached_property
    def largest_um(self) -> float:
        """Largest expected length in µm of the deviation without or with table over the workspace; the scale of all
        planes."""
        points = evaluation_grid(self.estimate.model.ranges_mm, _LATTICE)
        states = [self._deviation(points) - self._rigid_without(points)]
        if self.table is not None:
            states.append(self._compensated(points) - self._rigid_with(points))
        squares = [(left**2).sum(axis=1) + self._sigma_mm.values.reshape(-1) ** 2 for left in states]
        return UM_PER_MM * float(np.sqrt(np.max(squares)))

    def plane(self, normal: int, at_mm: float) -> FieldPlane:
        """Return the field on a plane; a position outside the travel is moved to its end."""
        low, high = self.ranges_mm[normal]
        at = min(max(at_mm, low), high)
        first, second = (axis for axis in range(3) if axis != normal)
        nodes = tuple(
            np.linspace(*self.ranges_mm[axis], count) for axis, count in zip((first, second), PLANE_SHAPE, strict=True)
        )
        points = np.empty((*PLANE_SHAPE, 3))
        points[..., first], points[..., second] = np.meshgrid(*nodes, indexing="ij")
        points[..., normal] = at
        flat = points.reshape(-1, 3)
        left = None if self.table is None else self._compensated(flat) - self._rigid_with(flat)
        return FieldPlane(
            normal=normal,
            at_mm=at,
            across=(first, second),
            nodes_mm=(nodes[0], nodes[1]),
            without_um=UM_PER_MM * (self._deviation(flat) - self._rigid_without(flat)).reshape(points.shape),
            with_um=None if left is None else UM_PER_MM * left.reshape(points.shape),
            sigma_um=UM_PER_MM * self._sigma_mm(flat).reshape(PLANE_SHAPE),
            measured=np.column_stack(
                (self.measured_mm[:, first], self.measured_mm[:, second], np.abs(self.measured_mm[:, normal] - at))
            ),
        )

    def _deviation(self, points: Array) -> Array:
        model, values = self.estimate.model, self.estimate.parameters
        return exact_deviation(model, points, self.tool_offset_mm, values)

    def _compensated(self, points: Array) -> Array:
        """Return the deviation of the compensated machine: d(X + c) + c at X, if c is the correction at X."""
        assert self.table is not None  # noqa: S101  asked for only with a table
        corrections = self.table.at(points)
        return self._deviation(points + corrections) + corrections

    @cached_property
    def _grid(self) -> Array:
        """Axis positions to which every volumetric error refers."""
        return evaluation_grid(self.estimate.model.ranges_mm)

    @cached_property
    def _sigma_mm(self) -> RegularGridInterpolator:
        from scipy.interpolate import RegularGridInterpolator  # noqa: PLC0415  a tenth of the start of the service

        ranges = self.estimate.model.ranges_mm
        points = evaluation_grid(ranges, _LATTICE)
        found = field_uncertainty(self.estimate, points, self.tool_offset_mm, aligned_over=self._grid)
        lines = [np.linspace(*limits, count) for limits, count in zip(ranges, _LATTICE, strict=True)]
        return RegularGridInterpolator(lines, np.linalg.norm(found, axis=1).reshape(_LATTICE))

    @cached_property
    def _everywhere_without(self) -> Array:
        return self._deviation(self._grid)

    @cached_property
    def _everywhere_with(self) -> Array:
        return self._compensated(self._grid)

    def _rigid_without(self, points: Array) -> Array:
        return rigid_part(self._grid + self.tool_offset_mm, self._everywhere_without, points + self.tool_offset_mm)

    def _rigid_with(self, points: Array) -> Array:
        return rigid_part(self._grid + self.tool_offset_mm, self._everywhere_with, points + self.tool_offset_mm)
