"""Conversion of model parameters whose lever arms were measured from the zeros of the axes.

The error model measures the lever arms of rotations and squareness from the lower ends of the axis ranges. Versions of
this software before estimate format 3 measured them from the zeros of the axes. Where a range does not begin at zero,
the same parameter values then mean another error field. To first order, the difference is a displacement that the
translations, the squareness and a rigid motion of the workpiece can represent, so the values can be converted.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from twin.arrays import Array
from twin.errors import ModelError
from twin.machine.error_model import DIRECTIONS, ErrorModel, series_orders
from twin.machine.kinematic_chain import AXES

_X, _Y, _Z = 0, 1, 2


def lower_ends_of_arms(model: ErrorModel) -> Array:
    """Return, for X, Y and Z, the vector (3, 3) in mm from the zeros to the lower ends of those axes whose travel is
    part of the lever arm of this axis."""
    low, arm, found = np.array(model.ranges_mm)[:, 0], np.zeros(3), np.zeros((3, 3))
    for letter in model.chain.axes:
        axis = AXES.index(letter)
        if letter in model.chain.tool_side:
            found[axis] = arm
        arm[axis] += low[axis]
        if letter in model.chain.workpiece_side:
            found[axis] = arm
    return found


def from_levers_at_axis_zeros(model: ErrorModel, tool_offset: Array) -> Array:
    """Return the matrix (p, p) that converts the p parameters of `model` from lever arms that begin at the zeros of the
    axes to lever arms that begin at the lower ends of the ranges.

    To first order and up to a rigid motion, the converted parameters have the same error field for a tool with the
    offset `tool_offset` (3,) in mm. Raises ModelError, which names the parameters, if the series of the model cannot
    represent the difference.
    """
    conversion = _Conversion.begin(model)
    levers = lower_ends_of_arms(model)
    for axis, lever in enumerate(levers):
        _convert_rotations(conversion, axis, lever)
    _convert_cross_effect(conversion, levers[_Z], tool_offset)
    _convert_slopes(conversion)
    return conversion.matrix


@dataclass(frozen=True, eq=False)
class _Conversion:
    """Conversion of the p parameters of `model`, while it is being built.

    `matrix` (p, p) contains what the parameters of the model represent. `slopes` (3, 3, p) contains the displacement in
    each direction that is proportional to each axis position, in mm per mm and per unit of each parameter; it has no
    parameter of its own where direction and axis differ.
    """

    model: ErrorModel
    matrix: Array
    slopes: Array

    @classmethod
    def begin(cls, model: ErrorModel) -> _Conversion:
        return cls(model, np.eye(model.size), np.zeros((3, 3, model.size)))

    def add(self, name: str, column: int, amount: float) -> None:
        if name not in self.model.names:
            changed = self.model.names[column]
            raise ModelError(f"the change of {changed} needs {name}, which the model does not contain", parameter=name)
        self.matrix[self.model.index(name), column] += amount


def _convert_rotations(conversion: _Conversion, axis: int, lever: Array) -> None:
    """Add the displacement ε × lever of the rotations ε of one axis."""
    model, letter = conversion.model, AXES[axis]
    low, high = model.ranges_mm[axis]
    for about in range(3):
        error = f"E{DIRECTIONS[3 + about]}{letter}"
        shift = np.cross(np.eye(3)[about], lever)
        start = model.block[error].start
        for column, order in enumerate(series_orders(error, model.orders[error]), start=start):
            for direction in np.flatnonzero(shift).tolist():
                if order == 1 and direction != axis:  # a slope of a straightness, which the series leaves out
                    conversion.slopes[direction, axis, column] += 2.0 * shift[direction] / (high - low)
                else:
                    conversion.add(f"E{DIRECTIONS[direction]}{letter}[{order}]", column, float(shift[direction]))


def _convert_cross_effect(conversion: _Conversion, lever: Array, tool_offset: Array) -> None:
    """Add the displacement (0, -lever_z, lever_y) (c0 + c1 w) v of the rotation that belongs to the cross-effect.

    v and w are the positions of Y and Z as fractions of their ranges.
    """
    model = conversion.model
    y_length, z_length = (high - low for low, high in (model.ranges_mm[_Y], model.ranges_mm[_Z]))
    for term in [one for one in model.cross_effect if one[0] == "c"]:
        column, straightness = model.index(f"CROSS[{term}]"), f"b{term[1]}"
        if lever[_Z] and (straightness in model.cross_effect or term == "c1"):
            conversion.add(f"CROSS[{straightness}]", column, -lever[_Z])
        elif lever[_Z]:
            conversion.add("EYY[1]", column, -0.5 * lever[_Z])  # b0 v is a scale error of Y
        if lever[_Y] and term == "c0":
            conversion.slopes[_Z, _Y, column] += lever[_Y] / y_length
        elif lever[_Y]:
            # lever_y w v = α (y - y0) is the effect of a roll α = share w of the Z axis on the part of its arm that Y
            # travels. The tool offset is in the arm too: its part (0, -α t_z, α t_y) is subtracted again. The roll
            # α = share (P1 + 1) / 2 has a constant part, whose effect on y - y0 is a slope.
            if "Z" in model.chain.workpiece_side:
                raise ModelError("the change of CROSS[c1] cannot be represented if Z carries the workpiece")
            share = lever[_Y] / y_length
            conversion.add("EAZ[1]", column, 0.5 * share)
            conversion.slopes[_Z, _Y, column] += 0.5 * share
            conversion.slopes[_Y, _Z, column] += share * tool_offset[_Z] / z_length
            conversion.add("EZZ[1]", column, -0.5 * share * tool_offset[_Y])


def _convert_slopes(conversion: _Conversion) -> None:
    """Represent the slopes g[direction, axis] by the squareness and a rotation ω of the workpiece.

    The rotation has the slopes ω × e of each axis direction e. It explains g_yx = ω_z, g_zx = -ω_y and g_zy = ω_x. What
    it leaves of g_yz, g_xz and g_xy is -A0Z, B0Z and -C0Y.
    """
    g, matrix, index = conversion.slopes, conversion.matrix, conversion.model.index
    matrix[index("A0Z")] -= g[_Y, _Z] + g[_Z, _Y]
    matrix[index("B0Z")] += g[_X, _Z] + g[_Z, _X]
    matrix[index("C0Y")] -= g[_X, _Y] + g[_Y, _X]
