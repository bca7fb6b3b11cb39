"""The deviation of the tool point to first order in the parameters: an analytic basis of the field."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from twin.arrays import Array, as_points, as_vector
from twin.chain import AXES
from twin.error_model import DIRECTIONS, ErrorModel, series_orders
from twin.legendre import legendre_values, normalised

_Y, _Z = 1, 2


def deviation_basis(model: ErrorModel, axis_positions: ArrayLike, tool_offset: ArrayLike) -> Array:
    """Derivative (n, 3, p) of the deviation with respect to the parameters at zero; C-contiguous."""
    points = as_points(axis_positions, "axis positions")
    arms = _nominal_arms(model, points, as_vector(tool_offset, 3, "tool offset"))
    basis = np.zeros((len(points), 3, model.size))
    for axis in range(3):
        _fill_series(basis, model, axis, points[:, axis], arms[axis])
    _fill_squareness(basis, model, points)
    _fill_cross_effect(basis, model, points, arms[_Z])
    return basis


def linear_deviation(
    model: ErrorModel, axis_positions: ArrayLike, tool_offset: ArrayLike, parameters: ArrayLike
) -> Array:
    """Deviation (n, 3) in mm to first order in the parameters (p,)."""
    vector = as_vector(parameters, model.size, "parameters")
    deviation: Array = deviation_basis(model, axis_positions, tool_offset) @ vector
    return deviation


def cross_arguments(model: ErrorModel, y: Array, z: Array) -> tuple[Array, Array]:
    """v and w of the cross-effect: shares of the ranges of Y and Z."""
    (y_low, y_high), (z_low, z_high) = model.ranges_mm[_Y], model.ranges_mm[_Z]
    return (y - y_low) / (y_high - y_low), (z - z_low) / (z_high - z_low)


def _nominal_arms(model: ErrorModel, points: Array, tool_offset: Array) -> tuple[Array, Array, Array]:
    """Per axis X, Y, Z the nominal vector (n, 3) from the point its rotations act about to the tool point."""
    arms = {}
    arm = np.repeat(tool_offset[None, :], len(points), axis=0)
    for letter in model.chain.axes:
        axis = AXES.index(letter)
        carried = arm.copy()
        arm[:, axis] += points[:, axis]
        arms[letter] = carried if letter in model.chain.tool_side else arm.copy()
    return arms["X"], arms["Y"], arms["Z"]


def _rotation_effects(arm: Array) -> tuple[tuple[tuple[int, Array], tuple[int, Array]], ...]:
    """For a unit rotation about X, Y, Z the components that change and by how much: e x arm."""
    x, y, z = arm.T
    return ((1, -z), (2, y)), ((0, z), (2, -x)), ((0, -y), (1, x))


def _fill_series(basis: Array, model: ErrorModel, axis: int, positions: Array, arm: Array) -> None:
    argument = normalised(positions, model.ranges_mm[axis])
    polynomials = np.ascontiguousarray(legendre_values(argument, model.highest_order[axis]).T)
    rotation_effects = _rotation_effects(arm)
    for row, direction in enumerate(DIRECTIONS):
        error = f"E{direction}{AXES[axis]}"
        orders = series_orders(error, model.orders[error])
        terms = polynomials[:, orders.start : orders.stop]
        if row < 3:
            basis[:, row, model.block[error]] = terms
            continue
        for component, lever in rotation_effects[row - 3]:
            basis[:, component, model.block[error]] = lever[:, None] * terms


def _fill_squareness(basis: Array, model: ErrorModel, points: Array) -> None:
    basis[:, 1, model.index("A0Z")] = -points[:, _Z]
    basis[:, 0, model.index("B0Z")] = points[:, _Z]
    basis[:, 0, model.index("C0Y")] = -points[:, _Y]


def _fill_cross_effect(basis: Array, model: ErrorModel, points: Array, arm: Array) -> None:
    v, w = cross_arguments(model, points[:, _Y], points[:, _Z])
    shapes = {"b0": v, "b1": w * v, "b2": w * w * v, "c0": v, "c1": w * v}
    for term in model.cross_effect:
        column = model.index(f"CROSS[{term}]")
        if term[0] == "b":
            basis[:, 1, column] = shapes[term]
            continue
        for component, lever in _rotation_effects(arm)[0]:
            basis[:, component, column] = lever * shapes[term]
