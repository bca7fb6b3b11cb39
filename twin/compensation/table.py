"""Compensation table: corrections on a grid that are added to the commanded axis positions. With the corrections, the
tool reaches its nominal position."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from twin.arrays import Array, as_points, as_vector
from twin.display import Displayed
from twin.errors import DataError, ModelError
from twin.machine.anchor import Anchor, anchoring_motion
from twin.machine.deviation_basis import deviation_basis
from twin.machine.error_model import ErrorModel, Ranges
from twin.machine.forward_model import exact_deviation
from twin.machine.kinematic_chain import AXES
from twin.machine.rigid_motion import rigid_fields

Nodes = tuple[Array, Array, Array]

_STEPS = 3  # iterations of c = rigid motion - d(X + c); each reduces the error to 1e-4, the slope of d
# of the ball bar of the case study: a node within half a ball pitch of the hull has measured balls around it
_HALF_BALL_PITCH_MM = 75.0
_LARGEST_STEP_MM = 100.0
_LEAST_CELLS = 12


@dataclass(frozen=True, eq=False)
class CompensationTable(Displayed):
    """Corrections at the nodes of a grid, interpolated trilinearly between the nodes.

    `x`, `y` and `z` contain the node positions of the three axes in mm. `corrections` (nx, ny, nz, 3) contains the
    corrections in mm, which are ADDED to the commanded axis position. The table is valid only for the tool offset
    `tool_offset` (3,) in mm (vector from the reference point of the ram to the stylus centre). `anchor` contains the
    six constraints that fix the rigid motion contained in the corrections. `extrapolated` (nx, ny, nz) is True for
    nodes outside the region in which the machine was measured. `gates_not_passed` contains the names of the
    gates that did not pass: such a table is marked, and is used only by consent. `machine` and `artefact` are the names
    of the machine that the table corrects and of the artefact with which it was measured; a name is empty if it is not
    known. Raises DataError if an array has the wrong shape, if node positions are not in ascending order or if a value
    is not finite.
    """

    x: Array
    y: Array
    z: Array
    corrections: Array
    tool_offset: Array
    anchor: Anchor
    extrapolated: np.ndarray[Any, np.dtype[np.bool_]]
    gates_not_passed: tuple[str, ...] = ()
    machine: str = ""
    artefact: str = ""

    def __repr__(self) -> str:
        shape = " × ".join(str(len(nodes)) for nodes in self.nodes)
        return f"<CompensationTable: {shape} nodes, machine {self.machine or 'not stated'}>"

    def __post_init__(self) -> None:
        for axis, nodes in zip(AXES, self.nodes, strict=True):
            if nodes.ndim != 1 or len(nodes) < 2 or not (np.isfinite(nodes).all() and (np.diff(nodes) > 0.0).all()):
                raise DataError("table nodes must be at least two ascending numbers", axis=axis)
        shape = (len(self.x), len(self.y), len(self.z))
        if self.corrections.shape != (*shape, 3) or self.extrapolated.shape != shape:
            raise DataError(f"corrections have the shape {self.corrections.shape}, expected {(*shape, 3)}")
        if not np.isfinite(self.corrections).all():
            raise DataError("a correction is not a finite number")

    @property
    def nodes(self) -> Nodes:
        return self.x, self.y, self.z

    def at(self, axis_positions: ArrayLike) -> Array:
        """Return the corrections (n, 3) in mm at axis positions (n, 3) in mm. Inside the grid the corrections are
        interpolated trilinearly; outside the grid they are equal to the corrections at the nearest point on its border.
        """
        points = as_points(axis_positions, "axis positions")
        cells, shares = zip(*(_cell(nodes, points[:, k]) for k, nodes in enumerate(self.nodes)), strict=True)
        total = np.zeros_like(points)
        for corner in np.ndindex(2, 2, 2):
            weight = np.ones(len(points))
            for share, side in zip(shares, corner, strict=True):
                weight *= share if side else 1.0 - share
            node = tuple(cell + side for cell, side in zip(cells, corner, strict=True))
            total += weight[:, None] * self.corrections[node]
        return total


@dataclass(frozen=True, eq=False)
class MeasuredRegion:
    """Convex region of axis positions that counts as measured.

    The region is bounded by m plane walls. `walls` (m, 4) contains the outward unit normal vector and the offset in mm
    of each wall. An axis position X is inside the region if normal · X + offset <= `margin_mm` for all walls.
    """

    walls: Array
    margin_mm: float

    @classmethod
    def around(cls, axis_positions: ArrayLike, margin_mm: float = _HALF_BALL_PITCH_MM) -> MeasuredRegion:
        """Return the region around measured axis positions (n, 3) in mm.

        The region is the convex hull of the axis positions or, if they are coplanar, their bounding box. Axis positions
        up to `margin_mm` beyond the walls of the hull or box also count as inside.
        """
        # Takes 0.04 s to import, and most commands make no table.
        from scipy.spatial import ConvexHull, QhullError  # noqa: PLC0415

        points = as_points(axis_positions, "measured axis positions")
        try:
            # Qhull refuses points in one plane, as one station with level bars gives them.
            return cls(ConvexHull(points).equations, margin_mm)
        except QhullError:
            outward = np.concatenate((np.eye(3), -np.eye(3)))
            return cls(
                np.column_stack((outward, -np.concatenate((points.max(axis=0), -points.min(axis=0))))), margin_mm
            )

    def contains(self, axis_positions: Array) -> np.ndarray[Any, np.dtype[np.bool_]]:
        """Return a mask (n,) that is True for each of the axis positions (n, 3) inside the region."""
        distance = axis_positions @ self.walls[:, :3].T + self.walls[:, 3]
        return np.asarray((distance <= self.margin_mm).all(axis=1))


def default_step_mm(ranges_mm: Ranges) -> tuple[float, float, float]:
    """Return the largest distance in mm between neighbouring nodes of a compensation table along X, Y and Z for axes
    with the ranges `ranges_mm`.

    The distance is 100 mm, or a twelfth of the range if that is less. The error motions of an axis are polynomials over
    its whole range, so the loss of linear interpolation depends on the number of nodes and not on their distance: with
    12 cells, the rms loss of a Legendre term of order 3 is 6 % of its rms value, and that of a term of order 5, whose
    amplitude is small, 28 %. With the 2 cells that 100 mm would give an axis of 200 mm, every term from order 3 would
    be lost.
    """
    x, y, z = (min(_LARGEST_STEP_MM, (high - low) / _LEAST_CELLS) for low, high in ranges_mm)
    return x, y, z


def regular_nodes(ranges_mm: Ranges, step_mm: tuple[float, float, float] | None = None) -> Nodes:
    """Return, for each axis, the node positions in mm of a regular grid. The nodes of an axis are spaced evenly over
    its range in `ranges_mm`, include both ends of the range, and are at most its value in `step_mm` apart. If `step_mm`
    is None, the distances of `default_step_mm` are used."""
    nodes = []
    for axis, (low, high), step in zip(AXES, ranges_mm, step_mm or default_step_mm(ranges_mm), strict=True):
        if not step > 0.0:
            raise ModelError(f"a table step must be positive, not {step}", axis=axis)
        # 1e-9: a range that is a whole number of steps must not get one cell more by rounding
        cells = max(1, int(np.ceil((high - low) / step - 1e-9)))
        nodes.append(np.linspace(low, high, cells + 1))
    x, y, z = nodes
    return x, y, z


def build_table(
    model: ErrorModel,
    parameters: ArrayLike,
    nodes: Nodes,
    tool_offset: ArrayLike,
    anchor: Anchor,
    measured: MeasuredRegion | ArrayLike,
) -> CompensationTable:
    """Build the compensation table of an error model with the values `parameters` (p,) of its p parameters for a tool
    offset (3,) in mm.

    At every node X of the grid `nodes`, the correction c and the deviation d of the model satisfy c(X) + d(X + c(X)) =
    r(X) to 1e-12 mm. Here r is the small rigid motion that `anchor` determines. The compensated model therefore
    deviates from its nominal positions only by r.

    Let two tables be built from the same estimate with different anchors. The two compensated machines then differ only
    by a small rigid motion that is linear in its rotation angle φ. A true rotation differs from this linear motion by
    φ²/2 times the distance from the centre of rotation, which amounts to nanometres. The corrections of the two tables
    differ by the same rigid motion up to some ten nanometres. This remainder is the slope of d times the difference of
    the corrections.

    `measured` is the measured region, or the measured axis positions (n, 3) in mm from which the region is built.
    Raises ModelError if the anchor is outside the range of the nodes.
    """
    values = as_vector(parameters, model.size, "parameters")
    offset = as_vector(tool_offset, 3, "tool offset")
    _check_anchor(anchor, nodes)
    shape = (len(nodes[0]), len(nodes[1]), len(nodes[2]))
    points = np.stack(np.meshgrid(*nodes, indexing="ij"), axis=-1).reshape(-1, 3)
    moved = anchoring_motion(lambda at: exact_deviation(model, at, offset, values)[:, :, None], _ends(nodes), anchor)[
        :, 0
    ]
    motion = _rigid(points, anchor, moved)
    # fixed point of c = r(X) - d(X + c)
    correction = np.zeros_like(points)
    for _ in range(_STEPS):
        correction = motion - exact_deviation(model, points + correction, offset, values)
    region = measured if isinstance(measured, MeasuredRegion) else MeasuredRegion.around(measured)
    return CompensationTable(
        x=nodes[0],
        y=nodes[1],
        z=nodes[2],
        corrections=correction.reshape(*shape, 3),
        tool_offset=offset,
        anchor=anchor,
        extrapolated=~region.contains(points).reshape(shape),
    )


def linear_corrections(
    model: ErrorModel, axis_positions: ArrayLike, nodes: Nodes, tool_offset: ArrayLike, anchor: Anchor
) -> Array:
    """Return the derivatives (n, 3, p) of a table's corrections at axis positions (n, 3) in mm with respect to the p
    parameters of the error model, for a table on the grid `nodes` with the anchor `anchor`.

    To first order in the parameters, the correction at X is c(X) = r(X) - d(X), see `build_table`.
    """
    points, offset = as_points(axis_positions, "axis positions"), as_vector(tool_offset, 3, "tool offset")
    motion = anchoring_motion(lambda at: deviation_basis(model, at, offset), _ends(nodes), anchor)
    return np.asarray(
        np.einsum("nij,jp->nip", rigid_fields(points, anchor.point_mm, 1.0), motion)
        - deviation_basis(model, points, offset)
    )


def _ends(nodes: Nodes) -> Ranges:
    """Return the first and the last node of each axis in mm."""
    x, y, z = ((float(line[0]), float(line[-1])) for line in nodes)
    return x, y, z


def _check_anchor(anchor: Anchor, nodes: Nodes) -> None:
    for axis, node, value in zip(AXES, nodes, anchor.point_mm.tolist(), strict=True):
        if not node[0] <= value <= node[-1]:
            message = f"the anchor point {value:g} is outside the table, {node[0]:g} to {node[-1]:g} mm"
            raise ModelError(message, axis=axis, hint="choose an anchor inside the travel")


def _rigid(points: Array, anchor: Anchor, motion: Array) -> Array:
    return np.asarray(rigid_fields(points, anchor.point_mm, 1.0) @ motion)


def _cell(nodes: Array, positions: Array) -> tuple[np.ndarray[Any, np.dtype[np.intp]], Array]:
    """Return, for each position, the index of its grid cell and its location in the cell as a fraction of the cell
    size.

    Positions beyond the border of the grid are clamped to the border.
    """
    inside = np.clip(positions, nodes[0], nodes[-1])
    cell = np.clip(np.searchsorted(nodes, inside, side="right") - 1, 0, len(nodes) - 2)
    return cell, (inside - nodes[cell]) / (nodes[cell + 1] - nodes[cell])
