"""From displacements of the tool point at axis positions to a deflection grid: checks, frame, datum, interpolation."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline, RegularGridInterpolator

from twin.arrays import Array
from twin.errors import DataError, ModelError
from twin.finite_elements.axis_frame import AxisFrame
from twin.machine.deflection import DeflectionGrid
from twin.machine.error_model import Ranges
from twin.machine.kinematic_chain import AXES
from twin.machine.volumetric import align_rigidly
from twin.units import UM_PER_MM

LengthUnit = Literal["um", "mm", "m"]
LENGTH_UNITS: tuple[LengthUnit, ...] = get_args(LengthUnit)
MM_PER_UNIT: dict[str, float] = {"um": 1e-3, "mm": 1.0, "m": 1e3}
PLAUSIBLE_UM = (0.02, 5000.0)
"""Largest displacement in µm that is plausible for a machine tool under gravity: a wrong unit is a factor of 1000."""
PLAUSIBLE_ROTATION_RAD = 0.02
MOST_FILLED = 0.2
"""Largest share of the nodes of a grid that is interpolated from the others."""
_NAMED = 5
_SAME_DIGITS = 6
_CUBIC_NODES = 4


@dataclass(frozen=True)
class ToolDisplacements:
    """Displacements (n, 3) in mm of the tool point at axis positions (n, 3) in mm, both in machine axes. `labels`
    says where each comes from."""

    axes_mm: Array
    displacements_mm: Array
    labels: tuple[str, ...]

    @property
    def largest_um(self) -> float:
        """Largest displacement relative to the mean one, in µm. A common shift of all positions is no deflection that
        varies, and a model may hang from anywhere."""
        return UM_PER_MM * float(np.abs(self.displacements_mm - self.displacements_mm.mean(axis=0)).max())


@dataclass(frozen=True)
class AssembledGrid:
    """Deflection grid, with the axis positions (m, 3) in mm of the nodes that were interpolated from others."""

    grid: DeflectionGrid
    filled_mm: Array


def tool_displacements(
    axes_mm: Array,
    displacements: Array,
    rotations: Array | None,
    labels: tuple[str, ...],
    unit: LengthUnit,
    frame: AxisFrame,
    offset_mm: Array,
) -> ToolDisplacements:
    """Return the displacements of the tool point from results (n, 3) of a model, in `unit` and in its `frame`.

    `offset_mm` (3,) is the vector from the node of the results to the tool point, in machine axes. `rotations` (n, 3)
    in rad move the tool point by their cross product with it. Raises DataError if an offset is stated without
    rotations, or if a rotation is too large for a deflection.
    """
    moved = MM_PER_UNIT[unit] * frame.vectors(displacements)
    if offset_mm.any():
        if rotations is None:
            raise DataError(
                "the tool point is offset from the node, but the results contain no rotations",
                hint="Export the rotations too, choose a node at the tool point, or leave out --offset",
            )
        turned = frame.rotations(rotations)
        worst = int(np.abs(turned).max(axis=1).argmax())
        if np.abs(turned[worst]).max() > PLAUSIBLE_ROTATION_RAD:
            message = f"a rotation of {np.abs(turned[worst]).max():.3g} rad at {labels[worst]} is no deflection"
            raise DataError(message, hint="Rotations must be in rad")
        moved = moved + np.cross(turned, offset_mm)
    return ToolDisplacements(axes_mm, moved, labels)


def check_size(found: ToolDisplacements, unit: LengthUnit) -> None:
    """Raise DataError if the displacements are too small or too large for a machine tool in the stated unit."""
    low, high = PLAUSIBLE_UM
    largest = found.largest_um
    if low <= largest <= high:
        return
    fitting = [other for other in LENGTH_UNITS if low <= largest * MM_PER_UNIT[other] / MM_PER_UNIT[unit] <= high]
    hint = f"In {' or '.join(fitting)} they would be plausible; check --unit" if fitting else "Check --unit"
    raise DataError(
        f"read in {unit}, the displacements vary by up to {largest:.3g} µm; {low:g} to {high:g} µm are plausible",
        hint=f"{hint}, or accept them with --any-size",
    )


def assemble_grid(found: ToolDisplacements, fill: bool = False, lost_mm: Array | None = None) -> AssembledGrid:
    """Return the deflection grid through displacements at its nodes.

    `lost_mm` (m, 3) are axis positions without a result, which are nodes of the grid all the same. Positions equal to a
    nanometre are the same node. With `fill`, a node without a result gets the mean of the
    interpolations along those grid lines on which it lies between others (a cubic spline; linear with fewer than four
    nodes). Raises DataError if a position is given twice, if positions are missing (naming the first ones), or if a
    missing node does not lie between others.
    """
    nodes, indices = [], []
    count_found = len(found.labels)
    asked = found.axes_mm if lost_mm is None else np.concatenate((found.axes_mm, lost_mm))
    for axis in range(3):
        unique, inverse = np.unique(np.round(asked[:, axis], _SAME_DIGITS), return_inverse=True)
        nodes.append(unique)
        indices.append(inverse.reshape(-1)[:count_found])
    shape = (nodes[0].size, nodes[1].size, nodes[2].size)
    _check_duplicates(np.stack(indices, axis=1), found.labels)
    count = math.prod(shape)
    missing = count - count_found
    if missing > 0 and (not fill or missing > MOST_FILLED * count):
        raise _missing(nodes, indices, missing, fill)
    values = np.full((*shape, 3), np.nan)
    values[tuple(indices)] = found.displacements_mm
    absent = np.argwhere(np.isnan(values[..., 0]))
    if len(absent):
        values = _filled(values, nodes, absent)
    try:
        grid = DeflectionGrid(nodes[0], nodes[1], nodes[2], values)
    except ModelError as error:
        raise DataError(error.message, hint=error.hint, **error.where) from None
    places = [[float(line[k]) for line, k in zip(nodes, index, strict=True)] for index in absent.tolist()]
    return AssembledGrid(grid, np.array(places).reshape(-1, 3))


def relative_to(grid: DeflectionGrid, reference_mm: Array) -> DeflectionGrid:
    """Return the grid minus its displacement at the axis position `reference_mm` (3,). Raises ModelError if this
    position is outside the grid."""
    return replace(grid, values=grid.values - grid.at(reference_mm)[0])


def middle_of(grid: DeflectionGrid) -> Array:
    """Return the axis position (3,) in mm in the middle of a grid."""
    return np.array([0.5 * (nodes[0] + nodes[-1]) for nodes in grid.nodes])


def without_rigid_motion(grid: DeflectionGrid) -> DeflectionGrid:
    """Return the grid minus the small rigid motion of the workspace that fits its nodes best."""
    values = align_rigidly(node_points(grid), grid.values.reshape(-1, 3))
    return replace(grid, values=values.reshape(grid.values.shape))


def node_points(grid: DeflectionGrid) -> Array:
    """Return the axis positions (n, 3) in mm of the nodes; z varies fastest."""
    return np.stack(np.meshgrid(*grid.nodes, indexing="ij"), axis=-1).reshape(-1, 3)


def resampled(grid: DeflectionGrid, shape: tuple[int, int, int]) -> DeflectionGrid:
    """Return the grid on evenly spaced nodes over the same ranges: cubic splines along each axis, linear along one with
    fewer than four nodes. Between their own nodes deflection grids are interpolated linearly, so a finer grid follows
    the curvature of the coarse one."""
    nodes = [np.linspace(line[0], line[-1], count) for line, count in zip(grid.nodes, shape, strict=True)]
    values = grid.values
    for axis, (old, new) in enumerate(zip(grid.nodes, nodes, strict=True)):
        if old.size >= _CUBIC_NODES:
            values = CubicSpline(old, values, axis=axis)(new)
        else:
            line = np.moveaxis(values, axis, 0)
            values = np.moveaxis(RegularGridInterpolator((old,), line)(new[:, None]), 0, axis)
    return DeflectionGrid(nodes[0], nodes[1], nodes[2], values)


def check_covers(grid: DeflectionGrid, ranges_mm: Ranges, machine: str) -> None:
    """Raise DataError, which names the axis, if the grid does not cover the axis ranges of a machine."""
    for axis, nodes, (low, high) in zip(AXES, grid.nodes, ranges_mm, strict=True):
        if nodes[0] > low + 1e-6 or nodes[-1] < high - 1e-6:
            message = (
                f"the grid ends at {nodes[0]:g} and {nodes[-1]:g} mm, the range of {machine} is {low:g} to {high:g}"
            )
            raise DataError(f"{message} mm", hint="Compute the positions at the ends of the travel too", axis=axis)


def _check_duplicates(indices: NDArray[np.intp], labels: tuple[str, ...]) -> None:
    first: dict[tuple[int, ...], str] = {}
    for index, label in zip(map(tuple, indices.tolist()), labels, strict=True):
        if index in first:
            raise DataError(f"the axis position of {label} is that of {first[index]} too")
        first[index] = label


def _missing(nodes: list[Array], indices: list[NDArray[np.intp]], count: int, fill: bool) -> DataError:
    """Return the error that names the first missing positions, found without an array over the whole grid."""
    known = set(zip(*(index.tolist() for index in indices), strict=True))
    shape = tuple(line.size for line in nodes)
    named = []
    for index in np.ndindex(shape):
        if index not in known:
            named.append(" ".join(f"{axis} {line[k]:g}" for axis, line, k in zip(AXES, nodes, index, strict=True)))
            if len(named) == min(_NAMED, count):
                break
    sizes = " x ".join(map(str, shape))
    more = "" if count <= _NAMED else f" and {count - _NAMED} more"
    if not fill:
        hint = "Compute them, or interpolate nodes that lie between others with --fill-missing"
    else:
        hint = f"At most {100 * MOST_FILLED:.0f} % of the nodes are interpolated"
    return DataError(
        f"{count} of {math.prod(shape)} positions of the {sizes} grid are missing: {'; '.join(named)}{more}", hint=hint
    )


def _filled(values: Array, nodes: list[Array], absent: NDArray[np.intp]) -> Array:
    """Return the values (nx, ny, nz, 3) with those at the indices `absent` (m, 3) interpolated."""
    filled = values.copy()
    for index in absent.tolist():
        guesses = []
        for axis, line in enumerate(nodes):
            along: list[int | slice] = list(index)
            along[axis] = slice(None)
            on_line = values[tuple(along)]
            known = np.isfinite(on_line[:, 0])
            k = index[axis]
            if known[:k].any() and known[k + 1 :].any():
                place = line[k]
                if known.sum() >= _CUBIC_NODES:
                    guesses.append(CubicSpline(line[known], on_line[known])(place))
                else:
                    guesses.append(np.array([np.interp(place, line[known], on_line[known, c]) for c in range(3)]))
        if not guesses:
            where = " ".join(f"{axis} {line[k]:g}" for axis, line, k in zip(AXES, nodes, index, strict=True))
            raise DataError(f"{where} is missing and does not lie between others", hint="Compute this position")
        filled[tuple(index)] = np.mean(guesses, axis=0)
    return filled
