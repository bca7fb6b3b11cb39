"""Compensation table: corrections added to the commanded axis position so that the tool reaches its nominal
position.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial import ConvexHull, QhullError

from twin.arrays import Array, as_points, as_vector
from twin.errors import DataError, ModelError
from twin.machine.error_model import ErrorModel, Ranges
from twin.machine.forward_model import exact_deviation
from twin.machine.kinematic_chain import AXES
from twin.machine.rigid_motion import rigid_fields

Nodes = tuple[Array, Array, Array]

_LINE_POINTS = 65  # points on an anchor line; the slope of any series is exact to far below a nanometre
_STEPS = 3  # iterations of c = rigid motion - d(X + c); each reduces the error to 1e-4
_HALF_BALL_PITCH_MM = 75.0


@dataclass(frozen=True, eq=False)
class Anchor:
    """Six constraints that determine the rigid motion of the corrections, which a free artefact cannot measure.

    The correction is zero at the axis position `point_mm` (3,), which gives three constraints. The best-fit straight
    line along the `primary` axis through that point keeps its direction (two constraints). The best-fit line along the
    `secondary` axis stays in the plane of both axes (one constraint).
    """

    point_mm: Array
    primary: str = "X"
    secondary: str = "Y"

    def __post_init__(self) -> None:
        object.__setattr__(self, "point_mm", as_vector(self.point_mm, 3, "anchor point"))
        if self.primary not in AXES or self.secondary not in AXES or self.primary == self.secondary:
            raise ModelError(
                f"an anchor needs two different axes, not '{self.primary}' and '{self.secondary}'",
                hint="for example primary X, secondary Y",
            )


@dataclass(frozen=True, eq=False)
class CompensationTable:
    """Table of `corrections` (nx, ny, nz, 3) mm at the nodes, interpolated trilinearly between them.

    The corrections are ADDED to the commanded axis position. The table is valid only for the tool offset `tool_offset`
    (3,) mm. `extrapolated` (nx, ny, nz): True for nodes outside the measured region. Raises DataError if shapes do not
    match, nodes are not in order or values are not finite.
    """

    x: Array
    y: Array
    z: Array
    corrections: Array
    tool_offset: Array
    anchor: Anchor
    extrapolated: np.ndarray[Any, np.dtype[np.bool_]]

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
        """Return corrections (n, 3) mm at axis positions (n, 3): trilinear inside the grid, constant beyond its
        border.
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
    """Convex measured region as half-spaces.

    `walls` (m, 4): normal vector and offset of each wall. An axis position X is inside if normal · X + offset <= margin
    for all walls.
    """

    walls: Array
    margin_mm: float

    @classmethod
    def around(cls, axis_positions: ArrayLike, margin_mm: float = _HALF_BALL_PITCH_MM) -> MeasuredRegion:
        """Return the region around measured axis positions (n, 3) mm.

        It is their convex hull, or their bounding box if they are coplanar.
        """
        points = as_points(axis_positions, "measured axis positions")
        try:
            return cls(ConvexHull(points).equations, margin_mm)
        except QhullError:
            outward = np.concatenate((np.eye(3), -np.eye(3)))
            return cls(
                np.column_stack((outward, -np.concatenate((points.max(axis=0), -points.min(axis=0))))), margin_mm
            )

    def contains(self, axis_positions: Array) -> np.ndarray[Any, np.dtype[np.bool_]]:
        """Return (n,) bool: True for each of the axis positions (n, 3) that is inside the region."""
        distance = axis_positions @ self.walls[:, :3].T + self.walls[:, 3]
        return np.asarray((distance <= self.margin_mm).all(axis=1))


def regular_nodes(ranges_mm: Ranges, step_mm: tuple[float, float, float]) -> Nodes:
    """Return evenly spaced nodes over the ranges, ends included, at most `step_mm` apart."""
    nodes = []
    for axis, (low, high), step in zip(AXES, ranges_mm, step_mm, strict=True):
        if not step > 0.0:
            raise ModelError(f"a table step must be positive, not {step}", axis=axis)
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
    """Build the table of a model with parameters (p,) for a tool offset (3,).

    At every node X, the correction c and the deviation d of the model satisfy c(X) + d(X + c(X)) = r(X) to 1e-12 mm.
    Here r is the small rigid motion that the anchor determines, so the compensated model deviates from nominal only by
    r. If one estimate is compensated with two different anchors, the compensated machines therefore differ only by a
    small rigid motion, linear in its rotation φ (a true rotation differs from it by φ²/2 times the distance, which is
    nanometres). The two tables differ by the same rigid motion up to some ten nanometres, the slope of d times the
    difference of the tables.

    `measured`: the measured region, or the measured axis positions (n, 3). Raises ModelError if the anchor is outside
    the range of the nodes.
    """
    values = as_vector(parameters, model.size, "parameters")
    offset = as_vector(tool_offset, 3, "tool offset")
    _check_anchor(anchor, nodes)
    shape = (len(nodes[0]), len(nodes[1]), len(nodes[2]))
    points = np.stack(np.meshgrid(*nodes, indexing="ij"), axis=-1).reshape(-1, 3)
    motion = _rigid(points, anchor, _anchoring_motion(model, values, nodes, offset, anchor))
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


def _check_anchor(anchor: Anchor, nodes: Nodes) -> None:
    for axis, node, value in zip(AXES, nodes, anchor.point_mm.tolist(), strict=True):
        if not node[0] <= value <= node[-1]:
            message = f"the anchor point {value:g} is outside the table, {node[0]:g} to {node[-1]:g} mm"
            raise ModelError(message, axis=axis, hint="choose an anchor inside the travel")


def _anchoring_motion(model: ErrorModel, values: Array, nodes: Nodes, offset: Array, anchor: Anchor) -> Array:
    """Return the small rigid motion (6,) that agrees with the deviation field in the six quantities of the anchor."""
    lines = _anchor_points(nodes, anchor)
    held = _constraints(exact_deviation(model, lines, offset, values)[:, :, None], lines, anchor)
    motions = _constraints(rigid_fields(lines, anchor.point_mm, 1.0), lines, anchor)
    return np.asarray(np.linalg.solve(motions, held[:, 0]))


def _anchor_points(nodes: Nodes, anchor: Anchor) -> Array:
    """Return the anchor point, then m points each on the primary and the secondary line, as an array (1 + 2 m,
    3) mm.
    """
    points = np.tile(anchor.point_mm, (1 + 2 * _LINE_POINTS, 1))
    for number, letter in enumerate((anchor.primary, anchor.secondary)):
        axis = AXES.index(letter)
        rows = slice(1 + number * _LINE_POINTS, 1 + (number + 1) * _LINE_POINTS)
        points[rows, axis] = np.linspace(nodes[axis][0], nodes[axis][-1], _LINE_POINTS)
    return points


def _constraints(fields: Array, points: Array, anchor: Anchor) -> Array:
    """Return the six quantities that the anchor constrains, (6, m), for m fields (n, 3, m) at the anchor points."""
    first, second = AXES.index(anchor.primary), AXES.index(anchor.secondary)
    third = 3 - first - second
    primary, secondary = slice(1, 1 + _LINE_POINTS), slice(1 + _LINE_POINTS, None)
    slopes_first = _slope(points[primary, first], fields[primary])
    slopes_second = _slope(points[secondary, second], fields[secondary])
    return np.concatenate((fields[0], slopes_first[[second, third]], slopes_second[[third]]))


def _slope(along: Array, fields: Array) -> Array:
    """Return the least-squares slope (3, m) of m fields (n, 3, m) as functions of `along` (n,)."""
    centred = along - along.mean()
    return np.asarray(np.tensordot(centred, fields, axes=1) / (centred @ centred))


def _rigid(points: Array, anchor: Anchor, motion: Array) -> Array:
    return np.asarray(rigid_fields(points, anchor.point_mm, 1.0) @ motion)


def _cell(nodes: Array, positions: Array) -> tuple[np.ndarray[Any, np.dtype[np.intp]], Array]:
    """Return for each position the index of its cell and its location in the cell as a fraction of the cell.

    Positions beyond the border are clamped to it.
    """
    inside = np.clip(positions, nodes[0], nodes[-1])
    cell = np.clip(np.searchsorted(nodes, inside, side="right") - 1, 0, len(nodes) - 2)
    return cell, (inside - nodes[cell]) / (nodes[cell + 1] - nodes[cell])
