"""The tool point of a machine with errors: the exact product along the chain, and its linear field.

Both give the deviation of the tool centre point relative to the workpiece from its nominal place (axis
positions + tool offset), in mm, in the axes of the machine.

From the workpiece to the tool the exact model is a product of homogeneous transforms. An axis q on the tool
side contributes `Trans(q u) Trans(EX, EY, EZ) Rz(EC) Ry(EB) Rx(EA)`, u being its direction of travel turned
by the squareness. An axis on the workpiece side carries the workpiece: its errors, too, are those of the
tool relative to the workpiece, and act in a frame that travels with the carriage, hence
`Trans(EX, EY, EZ) Rz(EC) Ry(EB) Rx(EA) Trans(q u)`: the arm of its rotations contains its own travel.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from twin.arrays import Array, as_points, as_vector
from twin.chain import AXES
from twin.error_model import DIRECTIONS, ErrorModel, series_orders
from twin.legendre import legendre_values, normalised

_CHUNK = 4096  # points whose intermediate rows stay in the second-level cache
_SMALL_ANGLE_RAD = 0.01  # below it four series terms give sine and cosine to the last bit
_Y, _Z = 1, 2


@dataclass(frozen=True)
class _Numbers:
    """A parameter vector unpacked: series per axis, travel directions less the nominal ones, cross terms."""

    series: tuple[Array, Array, Array]
    travel: tuple[Array, Array, Array]
    cross: tuple[float, ...]


def exact_deviation(
    model: ErrorModel, axis_positions: ArrayLike, tool_offset: ArrayLike, parameters: ArrayLike
) -> Array:
    """Deviation (n, 3) in mm by the exact product of transforms, for positions (n, 3), parameters (p,).

    Deviation and nominal arm are carried apart, so that no digits are lost on the 4 m of travel.
    """
    points = as_points(axis_positions, "axis positions")
    offset = as_vector(tool_offset, 3, "tool offset")
    numbers = _unpack(model, as_vector(parameters, model.size, "parameters"))
    deviation = np.empty_like(points)
    for start in range(0, len(points), _CHUNK):
        chunk = slice(start, start + _CHUNK)
        deviation[chunk] = _chain_deviation(model, np.ascontiguousarray(points[chunk].T), offset, numbers).T
    return deviation


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


def _unpack(model: ErrorModel, values: Array) -> _Numbers:
    a, b, c = model.squareness(values)
    sines, less_one = _sine_and_cosine_less_one(np.array([a, b, c]))
    sin_a, sin_b, sin_c = sines.tolist()
    cos_a1, cos_b1, cos_c1 = less_one.tolist()
    y_travel = np.array([-sin_c, cos_c1, 0.0])
    z_travel = np.array(
        [sin_b * (cos_a1 + 1.0), -sin_a, cos_a1 + cos_b1 + cos_a1 * cos_b1]
    )  # Ry(B0Z) Rx(A0Z) e_z
    x, y, z = (model.coefficients(axis, values) for axis in range(3))
    return _Numbers((x, y, z), (np.zeros(3), y_travel, z_travel), tuple(model.cross_terms(values).values()))


def _chain_deviation(model: ErrorModel, travel: Array, tool_offset: Array, numbers: _Numbers) -> Array:
    """(3, n) from axis positions (3, n): carries the tool point from frame to frame towards the workpiece."""
    arm = np.repeat(tool_offset[:, None], travel.shape[1], axis=1)
    deviation = np.zeros_like(arm)
    for letter in model.chain.axes:
        axis = AXES.index(letter)
        motions = _error_motions(model, axis, travel, numbers)
        if letter in model.chain.tool_side:
            _rotate(arm, deviation, motions[3:])
            _travel(arm, deviation, axis, travel, numbers)
        else:
            _travel(arm, deviation, axis, travel, numbers)
            _rotate(arm, deviation, motions[3:])
        deviation += motions[:3]
    return deviation


def _error_motions(model: ErrorModel, axis: int, travel: Array, numbers: _Numbers) -> Array:
    """EX, EY, EZ (mm), EA, EB, EC (rad) of one axis at axis positions (3, n): (6, n)."""
    coefficients = numbers.series[axis]
    argument = normalised(travel[axis], model.ranges_mm[axis])
    motions: Array = coefficients @ legendre_values(argument, coefficients.shape[1] - 1)
    if axis == _Z and model.cross_effect:
        v, w = _cross_arguments(model, travel[_Y], travel[_Z])
        b0, b1, b2, c0, c1 = numbers.cross
        motions[1] += ((b2 * w + b1) * w + b0) * v
        motions[3] += (c1 * w + c0) * v
    return motions


def _travel(arm: Array, deviation: Array, axis: int, travel: Array, numbers: _Numbers) -> None:
    arm[axis] += travel[axis]
    for component in np.flatnonzero(numbers.travel[axis]):
        deviation[component] += numbers.travel[axis][component] * travel[axis]


def _rotate(arm: Array, deviation: Array, angles: Array) -> None:
    """Turn arm + deviation by Rz(c) Ry(b) Rx(a), booking the change as deviation."""
    sines, less_one = _sine_and_cosine_less_one(angles)
    point = arm + deviation
    for about, (first, second) in enumerate(((1, 2), (2, 0), (0, 1))):
        sine, cosine_less_one = sines[about], less_one[about]
        change_first = cosine_less_one * point[first] - sine * point[second]
        change_second = sine * point[first] + cosine_less_one * point[second]
        for component, change in ((first, change_first), (second, change_second)):
            deviation[component] += change
            point[component] += change


def _sine_and_cosine_less_one(angles: Array) -> tuple[Array, Array]:
    """sin and cos - 1 to double precision; the series of small angles is several times as fast."""
    square = angles * angles
    if square.max(initial=0.0) > _SMALL_ANGLE_RAD**2:
        return np.sin(angles), -2.0 * np.sin(0.5 * angles) ** 2
    sine = angles * _nested(square, (6.0, 20.0, 42.0))
    less_one = -0.5 * square * _nested(square, (12.0, 30.0))
    return sine, less_one


def _nested(square: Array, divisors: tuple[float, ...]) -> Array:
    """1 - s/d1 (1 - s/d2 (1 - ...)): the Taylor series of sine and cosine without their leading factor."""
    value = 1.0 - square / divisors[-1]
    for divisor in divisors[-2::-1]:
        value *= square
        value *= -1.0 / divisor
        value += 1.0
    return value


def _cross_arguments(model: ErrorModel, y: Array, z: Array) -> tuple[Array, Array]:
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
    v, w = _cross_arguments(model, points[:, _Y], points[:, _Z])
    shapes = {"b0": v, "b1": w * v, "b2": w * w * v, "c0": v, "c1": w * v}
    for term in model.cross_effect:
        column = model.index(f"CROSS[{term}]")
        if term[0] == "b":
            basis[:, 1, column] = shapes[term]
            continue
        for component, lever in _rotation_effects(arm)[0]:
            basis[:, component, column] = lever * shapes[term]
