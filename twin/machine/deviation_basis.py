"""Derivatives of the tool point deviation with respect to the parameters of the error model of a machine, in closed
form."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from twin.arrays import Array, as_points, as_vector
from twin.machine.error_model import DIRECTIONS, ErrorModel, series_orders
from twin.machine.kinematic_chain import AXES
from twin.machine.legendre import legendre_values, normalise_positions

_X, _Y, _Z = 0, 1, 2

_CHUNK = 128  # number of points whose functions fit into the processor cache
ColumnIndices = np.ndarray[Any, np.dtype[np.int64]]


def deviation_basis(
    model: ErrorModel, axis_positions: ArrayLike, tool_offset: ArrayLike, scale: Array | None = None
) -> Array:
    """Return the derivative (n, 3, p) of the tool point deviation at axis positions (n, 3) with respect to the p
    parameters of the error model. The derivative is taken where all parameters are zero.

    Each parameter displaces the tool point by an effect multiplied by a function of the axis positions. There are
    twelve effects: three translations, and three rotations of each of the three axes. `scale` (p,) is the unit of each
    parameter in mm or rad; if `scale` is None, the units are 1 mm and 1 rad. The returned array is C-contiguous.
    """
    points = as_points(axis_positions, "axis positions")
    arms = _nominal_arms(model, points, as_vector(tool_offset, 3, "tool offset"))
    effect, row = _columns(model)
    # column j of the basis = effect(j) (3,) times function(j) of the axis positions
    effects, functions = _effects(arms), _functions(model, points)
    basis = np.empty((len(points), 3, model.size))
    for start in range(0, len(points), _CHUNK):
        chunk = slice(start, start + _CHUNK)
        shares = functions[chunk].take(row, axis=1)
        if scale is not None:
            shares *= scale
        np.take(effects[chunk], effect, axis=2, out=basis[chunk], mode="clip")  # any other mode copies through a buffer
        basis[chunk] *= shares[:, None, :]
    return basis


def deviation_basis_of_tools(
    model: ErrorModel, axis_positions: Array, tool: ColumnIndices, tool_offsets: Array, scale: Array | None = None
) -> Array:
    """Return the derivative (n, 3, p) as `deviation_basis` does, if each of the n rows was measured with its own tool.

    `tool` (n,) is an index into the `tool_offsets` (T, 3).
    """
    basis = np.empty((len(axis_positions), 3, model.size))
    for number in np.unique(tool):
        rows = tool == number
        basis[rows] = deviation_basis(model, axis_positions[rows], tool_offsets[number], scale)
    return basis


def linear_deviation(
    model: ErrorModel, axis_positions: ArrayLike, tool_offset: ArrayLike, parameters: ArrayLike
) -> Array:
    """Return the tool point deviation (n, 3) in mm at axis positions (n, 3), computed to first order in the p model
    parameters (p,)."""
    vector = as_vector(parameters, model.size, "parameters")
    deviation: Array = deviation_basis(model, axis_positions, tool_offset) @ vector
    return deviation


def axis_fractions(model: ErrorModel, positions: Array) -> tuple[Array, Array, Array]:
    """Return the positions of X, Y and Z, the rows of `positions` (3, n) in mm, as fractions of the axis ranges: 0 at
    the lower end, 1 at the upper end."""
    x, y, z = ((row - low) / (high - low) for row, (low, high) in zip(positions, model.ranges_mm, strict=True))
    return x, y, z


def cross_arguments(model: ErrorModel, y: Array, z: Array) -> tuple[Array, Array]:
    """Return the two arguments v and w of the cross-effect of column and ram: the axis positions of Y and Z as
    fractions of the axis ranges."""
    (y_low, y_high), (z_low, z_high) = model.ranges_mm[_Y], model.ranges_mm[_Z]
    return (y - y_low) / (y_high - y_low), (z - z_low) / (z_high - z_low)


def _nominal_arms(model: ErrorModel, points: Array, tool_offset: Array) -> tuple[Array, Array, Array]:
    """Return, for each of the axes X, Y and Z, the nominal vector (n, 3) from the centre of the axis's rotations to the
    tool point."""
    arms = {}
    arm = np.repeat(tool_offset[None, :], len(points), axis=0)
    for letter in model.chain.axes:
        axis = AXES.index(letter)
        # The rotations of an axis on the tool side act before its travel, those on the workpiece side after it.
        carried = arm.copy()
        arm[:, axis] += points[:, axis] - model.ranges_mm[axis][0]
        arms[letter] = carried if letter in model.chain.tool_side else arm.copy()
    return arms["X"], arms["Y"], arms["Z"]


def _effects(arms: tuple[Array, Array, Array]) -> Array:
    """Return the twelve effects (n, 3, 12): unit translations along X, Y, Z, then unit rotations about X, Y, Z of each
    axis.

    A rotation about the unit vector e displaces the tool point by e × arm.
    """
    effects = np.zeros((len(arms[0]), 3, 12))
    for axis, arm in enumerate(arms):
        for one, two, three in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
            # rotation about axis `one`: e x arm has the components (two: -arm_three, three: arm_two)
            effects[:, one, one] = 1.0
            effects[:, three, 3 + 3 * axis + one] = arm[:, two]
            effects[:, two, 3 + 3 * axis + one] = -arm[:, three]
    return effects


def _functions(model: ErrorModel, points: Array) -> Array:
    """Return the functions (n, f) of the axis positions: the Legendre polynomials of X, of Y and of Z, then -z, z and
    -y for the squareness, then the functions of the cross-effect."""
    columns = [
        legendre_values(normalise_positions(points[:, axis], model.ranges_mm[axis]), model.highest_order[axis])
        for axis in range(3)
    ]
    y, z = points[:, _Y], points[:, _Z]
    y_travel, z_travel = y - model.ranges_mm[_Y][0], z - model.ranges_mm[_Z][0]
    columns.append(np.array((-z_travel, z_travel, -y_travel)))
    if model.cross_terms:
        fractions = axis_fractions(model, points.T)
        columns.append(np.array([term.polynomial.at(fractions) for term in model.cross_terms]))
    return np.ascontiguousarray(np.concatenate(columns).T)


@lru_cache(maxsize=16)
def _columns(model: ErrorModel) -> tuple[ColumnIndices, ColumnIndices]:
    """Return two index arrays (p,) for the p parameters: the effect of each parameter in `_effects`, and its function
    in `_functions`."""
    starts = np.cumsum([0, *(order + 1 for order in model.highest_order)]).tolist()
    effect, row = np.empty(model.size, dtype=np.int64), np.empty(model.size, dtype=np.int64)
    for error, block in model.block.items():
        orders = series_orders(error, model.orders[error])
        effect[block] = _effect(error)
        row[block] = starts[AXES.index(error[2])] + np.arange(orders.start, orders.start + len(orders))
    # Squareness rotates a direction of travel only, so its effect is a translation.
    others = {"A0Z": _Y, "B0Z": _X, "C0Y": _X}
    others |= {term.name: _effect(term.error) for term in model.cross_terms}
    for number, (name, moved) in enumerate(others.items()):
        effect[model.index(name)] = moved
        row[model.index(name)] = starts[-1] + number
    # the cache hands the same arrays to every caller
    effect.setflags(write=False)
    row.setflags(write=False)
    return effect, row


def _effect(error: str) -> int:
    """Return the index in `_effects` of the error motion `error`."""
    direction, axis = DIRECTIONS.index(error[1]), AXES.index(error[2])
    # effects 0 to 2 are translations; the rotations A, B, C (directions 3 to 5) of axis k are the effects 3 + 3 k to
    # 5 + 3 k
    return direction if direction < 3 else 3 * axis + direction
