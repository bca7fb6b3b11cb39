"""Deviation of the tool point of a machine with errors, computed by the exact product of transforms or to first order.

The deviation is the vector from the nominal to the actual position of the tool centre point, relative to the workpiece,
in mm along the machine axes. The nominal position is the sum of the axis positions and the tool offset.

The exact model is a product of homogeneous transforms, in the order from the workpiece to the tool. Let q be the travel
of an axis from the lower end of its range, and u its direction of travel, rotated by the squareness. EX, EY, EZ and EA,
EB, EC are the error motions of the axis. An axis on the tool side contributes `Trans(q u) Trans(EX, EY, EZ) Rz(EC)
Ry(EB) Rx(EA)`. An axis on the workpiece side carries the workpiece. The error motions of such an axis are also errors
of the tool relative to the workpiece, but they apply in a frame that travels with the carriage. An axis on the
workpiece side therefore contributes `Trans(EX, EY, EZ) Rz(EC) Ry(EB) Rx(EA) Trans(q u)`: the lever arm of its rotations
contains its own travel.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from twin.arrays import Array, as_points, as_vector
from twin.immutable import Immutable
from twin.machine.axis_polynomial import AxisPolynomial
from twin.machine.deviation_basis import axis_fractions, deviation_basis, linear_deviation
from twin.machine.error_model import DIRECTIONS, ERROR_MOTIONS, ErrorModel, series_orders
from twin.machine.kinematic_chain import AXES
from twin.machine.legendre import to_power_series

__all__ = ["deviation_basis", "exact_deviation", "linear_deviation"]

_CHUNK = 6000  # points: more do not fit into the cache, with fewer the call overhead dominates
_SMALL_ANGLE_RAD = 2e-4  # below it the first neglected term is under 7e-17, half a unit in the last place of cos

Triple = tuple[float, float, float]


@dataclass(frozen=True)
class _UnpackedParameters:
    """Parameter vector unpacked for the evaluation.

    `series` (3, 6, order + 1) contains the power series coefficients of each axis and error motion. `travel` is the
    actual minus the nominal direction of travel of each axis. `cross[axis]` contains the cross-effect of each axis: the
    row of an error motion (0 to 5) and the polynomial in mm or rad that is added to it.
    """

    series: Array
    travel: tuple[Triple, Triple, Triple]
    cross: tuple[tuple[tuple[int, AxisPolynomial], ...], ...]


class _Workspace:
    """Preallocated arrays for `count` points. They are refilled for every chunk of points and every axis, because
    allocating new memory each time would cost more than the arithmetic."""

    def __init__(self, count: int, terms: int) -> None:
        self.positions = np.empty((3, count))
        self.powers = np.empty((terms, count))
        self.motions = np.empty((6, count))
        self.sines = np.empty((3, count))
        self.cosine_minus_one = np.empty((3, count))
        self.arm = np.empty((3, count))
        self.deviation = np.empty((3, count))
        self.point = np.empty((3, count))
        self.changes = np.empty((6, count))
        self.product = np.empty(count)
        self.travelled = np.empty(count)


def exact_deviation(
    model: ErrorModel, axis_positions: ArrayLike, tool_offset: ArrayLike, parameters: ArrayLike
) -> Array:
    """Return the tool point deviation (n, 3) in mm for axis positions (n, 3) and the p model parameters (p,), computed
    by the exact product of transforms.

    The deviation and the nominal vector from the frame of each axis to the tool point (the lever arm) are computed as
    separate numbers. The deviation therefore loses no digits, even if the travel is 4 m.
    """
    return ExactDeviation(model, tool_offset, parameters).at(axis_positions)


class ExactDeviation(Immutable):
    """Exact tool point deviation of one machine as a function of the axis position, see `exact_deviation`.

    The p model parameters (p,) are unpacked only once. This matters if the deviation is wanted at many single positions
    one after the other, where unpacking takes as long as a quarter of the evaluation.
    """

    def __init__(self, model: ErrorModel, tool_offset: ArrayLike, parameters: ArrayLike) -> None:
        self._model = model
        self._offset = as_vector(tool_offset, 3, "tool offset")
        self._numbers = _unpack(model, as_vector(parameters, model.size, "parameters"))

    def at(self, axis_positions: ArrayLike) -> Array:
        """Return the deviation (n, 3) in mm at axis positions (n, 3) in mm."""
        points = as_points(axis_positions, "axis positions")
        deviation = np.empty_like(points)
        size = min(len(points), _CHUNK)
        rows = _Workspace(size, self._numbers.series.shape[2])
        for start in range(0, len(points), _CHUNK):
            chunk = slice(min(start, len(points) - size), start + size)  # the last chunk overlaps the previous one
            np.copyto(rows.positions, points[chunk].T)
            _carry_tool_point(self._model, self._offset, self._numbers, rows)
            deviation[chunk] = rows.deviation.T
        return deviation


def _unpack(model: ErrorModel, values: Array) -> _UnpackedParameters:
    a, b, c = model.squareness(values)
    # cos φ - 1 = -2 sin²(φ/2), which keeps all digits of a small angle
    cos_a1, cos_b1, cos_c1 = (-2.0 * math.sin(0.5 * angle) ** 2 for angle in (a, b, c))
    z_turned = (  # Ry(B0Z) Rx(A0Z) e_z - e_z
        math.sin(b) * math.cos(a),
        -math.sin(a),
        cos_a1 + cos_b1 + cos_a1 * cos_b1,
    )
    positions = _series_positions(model)
    series = np.zeros((3, 6, max(model.highest_order) + 1))
    series.reshape(-1)[positions] = values[: len(positions)]
    series = to_power_series(series)
    travel = ((0.0, 0.0, 0.0), (-math.sin(c), cos_c1, 0.0), z_turned)
    return _UnpackedParameters(series, travel, _cross_effect(model, values))


def _cross_effect(model: ErrorModel, values: Array) -> tuple[tuple[tuple[int, AxisPolynomial], ...], ...]:
    """Return, for each axis, the rows of its error motions that have a cross-effect, and the sum of its terms."""
    found: dict[str, AxisPolynomial] = {}
    for term, value in zip(model.cross_terms, model.cross_values(values).tolist(), strict=True):
        found[term.error] = found.get(term.error, AxisPolynomial()) + term.polynomial * value
    return tuple(
        tuple((DIRECTIONS.index(error[1]), total) for error, total in found.items() if error[2] == letter)
        for letter in AXES
    )


@lru_cache(maxsize=16)
def _series_positions(model: ErrorModel) -> np.ndarray[Any, np.dtype[np.int64]]:
    """Return the indices of the series parameters in a flattened table (3, 6, highest order + 1).

    The series parameters come first in a parameter vector.
    """
    terms = max(model.highest_order) + 1
    positions = []
    for row, error in enumerate(ERROR_MOTIONS):
        orders = series_orders(error, model.orders[error])
        positions += [row * terms + order for order in orders]
    return np.array(positions, dtype=np.int64)


def _carry_tool_point(model: ErrorModel, tool_offset: Array, numbers: _UnpackedParameters, rows: _Workspace) -> None:
    """Transform the tool point from frame to frame towards the workpiece. The result is stored in `rows.deviation`."""
    rows.arm[:] = tool_offset[:, None]
    rows.deviation[:] = 0.0
    for letter in model.chain.axes:
        axis = AXES.index(letter)
        _fill_error_motions(axis, model, numbers, rows)
        _fill_sines(rows)
        if letter in model.chain.tool_side:
            _rotate(rows)
            _travel(axis, model, numbers, rows)
        else:
            _travel(axis, model, numbers, rows)
            _rotate(rows)
        rows.deviation += rows.motions[:3]


def _fill_error_motions(axis: int, model: ErrorModel, numbers: _UnpackedParameters, rows: _Workspace) -> None:
    """Fill `rows.motions` with EX, EY, EZ (mm) and EA, EB, EC (rad) of one axis."""
    low, high = model.ranges_mm[axis]
    powers = rows.powers
    powers[0] = 1.0
    argument = np.subtract(rows.positions[axis], 0.5 * (low + high), out=powers[1])
    argument *= 2.0 / (high - low)
    for k in range(2, len(powers)):
        np.multiply(powers[k - 1], argument, out=powers[k])
    np.matmul(numbers.series[axis], powers, out=rows.motions)
    if numbers.cross[axis]:
        fractions = axis_fractions(model, rows.positions)
        for row, polynomial in numbers.cross[axis]:
            rows.motions[row] += polynomial.at(fractions)


def _fill_sines(rows: _Workspace) -> None:
    """Compute, to double precision, the sine and the cosine minus 1 of all angles.

    Small angles are evaluated by their power series, which is several times as fast.
    """
    angles = rows.motions[3:]
    square = np.multiply(angles, angles, out=rows.cosine_minus_one)
    if square.max(initial=0.0) > _SMALL_ANGLE_RAD**2:
        np.sin(angles, out=rows.sines)
        rows.cosine_minus_one[:] = -2.0 * np.sin(0.5 * angles) ** 2
        return
    np.multiply(square, -1.0 / 6.0, out=rows.sines)
    rows.sines *= angles
    rows.sines += angles
    square *= -0.5


def _travel(axis: int, model: ErrorModel, numbers: _UnpackedParameters, rows: _Workspace) -> None:
    arm = rows.arm[axis]
    positions = np.subtract(rows.positions[axis], model.ranges_mm[axis][0], out=rows.travelled)
    # nominal travel goes into the arm, q (u - e_q) into the deviation
    arm += positions
    for component, share in enumerate(numbers.travel[axis]):
        if share != 0.0:
            deviation = rows.deviation[component]
            deviation += np.multiply(positions, share, out=rows.product)


def _rotate(rows: _Workspace) -> None:
    """Rotate the sum of lever arm and deviation by Rz(EC) Ry(EB) Rx(EA), and add the change of the sum to the
    deviation.

    The cosines are stored minus 1. The change is therefore computed directly and not as the difference of two long
    arms.
    """
    x, y, z = np.add(rows.arm, rows.deviation, out=rows.point)
    change_y, change_z, last_z, change_x, last_x, last_y = rows.changes
    about_x, about_y, about_z = zip(rows.sines, rows.cosine_minus_one, strict=True)
    _turn((y, z), about_x, (change_y, change_z), rows.product)
    y += change_y
    z += change_z
    _turn((z, x), about_y, (last_z, change_x), rows.product)
    x += change_x
    _turn((x, y), about_z, (last_x, last_y), rows.product)
    changes = ((change_x, last_x), (change_y, last_y), (change_z, last_z))
    for deviation, (change, last) in zip(rows.deviation, changes, strict=True):
        np.add(deviation, np.add(change, last, out=rows.product), out=deviation)


def _turn(
    components: tuple[Array, Array], angle: tuple[Array, Array], changes: tuple[Array, Array], product: Array
) -> None:
    """Compute the changes of two vector components if the vector is rotated from the first component towards the
    second.

    `angle` contains the sine of the angle, and its cosine minus 1.
    """
    (first, second), (sine, cosine_minus_one) = components, angle
    np.multiply(cosine_minus_one, first, out=changes[0])
    np.subtract(changes[0], np.multiply(sine, second, out=product), out=changes[0])
    np.multiply(sine, first, out=changes[1])
    np.add(changes[1], np.multiply(cosine_minus_one, second, out=product), out=changes[1])
