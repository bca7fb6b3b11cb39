"""Parameters of a machine model and their relation to the 18 error motions at an axis position.

The names of the error motions are those of ISO 230-1. A name consists of the letter E, the direction of the error
(X, Y, Z for a displacement, A, B, C for a rotation) and the moving axis. Each of the 18 error motions is a Legendre
series in the axis position normalised to [-1, 1]. Terms that are only a rigid motion or only a squareness are left out
by construction: all constants (order 0) and the slope of a straightness (order 1).

The sign of each squareness is defined only here. In A0Z, for example, Z is the axis whose direction of travel is
rotated from its nominal direction, and A means that the rotation is about X (B about Y, C about Z). The rotation is
right-handed. Let y0 and z0 be the lower ends of the ranges of Y and Z. To first order, the deviation d at the axis
position y or z is therefore

    A0Z  z-travel, about X:  d = (0, -A0Z (z - z0), 0)
    B0Z  z-travel, about Y:  d = (B0Z (z - z0), 0, 0)
    C0Y  y-travel, about Z:  d = (-C0Y (y - y0), 0, 0)

A squareness rotates only the direction of travel, not the parts that the carriage carries. The lever arms of the
rotations contain the travel from the lower ends of the ranges too, so no parameter depends on the zeros of the axes.

The cross-effect of column and ram (the ram's weight bends the column) is added to EYZ and EAZ. Let v = (y - y0)/Ly and
w = (z - z0)/Lz, where Ly and Lz are the lengths of the ranges of Y and Z. The terms of the cross-effect are

    E_YZ(y, z) = (b0 + b1 w + b2 w²) v     b in mm
    E_AZ(y, z) = (c0 + c1 w) v             c in rad

The coefficient b0 is off by default because b0 v is a scale error of Y, which EYY[1] already describes. The coefficient
c0 is off by default because c0 v gives a vertical displacement, which EZY[2] and A0Z already describe. Both statements
are true up to a rigid motion, and only for a machine whose ram carries the tool.

Other structures have other terms of the cross-effect, which `twin.machine.structure` derives from their beams. Each is
a polynomial in the axis positions that is added to one error motion.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Literal

import numpy as np

from twin.arrays import Array
from twin.errors import DataError, ModelError
from twin.immutable import Immutable
from twin.machine.cross_term import COLUMN_AND_RAM, CROSS, CrossTerm
from twin.machine.kinematic_chain import AXES, Chain

DIRECTIONS = ("X", "Y", "Z", "A", "B", "C")
ERROR_MOTIONS = tuple(f"E{direction}{axis}" for axis in AXES for direction in DIRECTIONS)
SQUARENESS = ("A0Z", "B0Z", "C0Y")
CROSS_TERMS = tuple(COLUMN_AND_RAM)
DEFAULT_CROSS_EFFECT = ("b1", "b2", "c1")

ParameterKind = Literal["positioning", "straightness", "rotation", "squareness", "cross_displacement", "cross_rotation"]
Ranges = tuple[tuple[float, float], tuple[float, float], tuple[float, float]]


@dataclass(frozen=True)
class Parameter:
    """Coefficient of the error model.

    `error` is the ISO name of the error, or CROSS for a term of the cross-effect, whatever its beam. `order` is the
    Legendre order; it is 0 for a term that is not a Legendre term.
    """

    name: str
    error: str
    order: int
    unit: Literal["mm", "rad"]
    kind: ParameterKind


@dataclass(frozen=True)
class ErrorModel(Immutable):
    """Error model of a machine. The model consists of the kinematic chain, the axis ranges, the Legendre order of each
    error motion and the active terms of the cross-effect. `cross_effect` contains the short names of the terms of
    column and ram, `structure` the terms of other beams."""

    chain: Chain
    ranges_mm: Ranges
    orders: Mapping[str, int] = field(hash=False)
    cross_effect: tuple[str, ...] = DEFAULT_CROSS_EFFECT
    structure: tuple[CrossTerm, ...] = ()

    def __post_init__(self) -> None:
        _check_ranges(self.ranges_mm)
        _check_orders(self.orders)
        _check_cross_effect(self.cross_effect)
        _check_structure(self.structure)

    @classmethod
    def uniform(
        cls,
        chain: Chain,
        ranges_mm: Ranges,
        order: int = 5,
        cross_effect: tuple[str, ...] = DEFAULT_CROSS_EFFECT,
        structure: tuple[CrossTerm, ...] = (),
    ) -> ErrorModel:
        """Return a model with the same Legendre order for all 18 error motions."""
        return cls(chain, ranges_mm, dict.fromkeys(ERROR_MOTIONS, order), cross_effect, structure)

    def with_orders(self, orders: Mapping[str, int]) -> ErrorModel:
        """Return the same model with other Legendre orders of the error motions."""
        return replace(self, orders=orders)

    @cached_property
    def parameters(self) -> tuple[Parameter, ...]:
        """Parameters of the model. Their order is also the order of every parameter vector (p,) and of the columns of
        every derivative of the deviation with respect to the parameters."""
        series = [_term(error, k) for error in ERROR_MOTIONS for k in series_orders(error, self.orders[error])]
        squareness = [Parameter(name, name, 0, "rad", "squareness") for name in SQUARENESS]
        return (*series, *squareness, *(_cross_parameter(term) for term in self.cross_terms))

    @cached_property
    def cross_terms(self) -> tuple[CrossTerm, ...]:
        """Active terms of the cross-effect. Their parameters are the last ones of a parameter vector, in this order."""
        return (*(COLUMN_AND_RAM[term] for term in self.cross_effect), *self.structure)

    @cached_property
    def names(self) -> tuple[str, ...]:
        return tuple(parameter.name for parameter in self.parameters)

    @property
    def size(self) -> int:
        return len(self.parameters)

    def index(self, name: str) -> int:
        """Return the index of the parameter called `name`.

        Raises ModelError if the model has no such parameter.
        """
        index = self._indices.get(name)
        if index is None:
            raise ModelError(f"the model has no parameter '{name}'", hint="Example names: EYX[2], A0Z, CROSS[b1]")
        return index

    @cached_property
    def _indices(self) -> dict[str, int]:
        return {name: index for index, name in enumerate(self.names)}

    @cached_property
    def block(self) -> Mapping[str, slice]:
        """Slices of a parameter vector by the ISO name of an error motion. Each slice selects the coefficients of this
        error motion."""
        blocks, start = {}, 0
        for error in ERROR_MOTIONS:
            count = len(series_orders(error, self.orders[error]))
            blocks[error] = slice(start, start + count)
            start += count
        return blocks

    @cached_property
    def highest_order(self) -> tuple[int, int, int]:
        """Highest Legendre order of the error motions of each of the axes X, Y and Z. It is at least 1."""
        highest = [max(1, *(self.orders[f"E{direction}{axis}"] for direction in DIRECTIONS)) for axis in AXES]
        return highest[0], highest[1], highest[2]

    def coefficients(self, axis: int, values: Array) -> Array:
        """Return the Legendre coefficients (6, highest order + 1) of the six error motions of one axis, taken from a
        parameter vector (p,)."""
        table = np.zeros((6, max(self.highest_order) + 1))
        for row, direction in enumerate(DIRECTIONS):
            error = f"E{direction}{AXES[axis]}"
            orders = series_orders(error, self.orders[error])
            table[row, orders.start : orders.stop] = values[self.block[error]]
        return table

    def squareness(self, values: Array) -> tuple[float, float, float]:
        """Return the squareness parameters A0Z, B0Z and C0Y in rad from a parameter vector (p,)."""
        start = self.block[ERROR_MOTIONS[-1]].stop
        return float(values[start]), float(values[start + 1]), float(values[start + 2])

    def cross_values(self, values: Array) -> Array:
        """Return the values (c,) in mm or rad of the parameters of the c active cross-effect terms."""
        return values[self.size - len(self.cross_terms) :]

    def column_and_ram(self, values: Array) -> Mapping[str, float]:
        """Return the coefficients b0, b1, b2 (mm) and c0, c1 (rad) of the cross-effect of column and ram. Terms that
        are not active are zero."""
        terms = dict.fromkeys(CROSS_TERMS, 0.0)
        terms.update(zip(self.cross_effect, self.cross_values(values).tolist(), strict=False))
        return terms

    @cached_property
    def field_degrees(self) -> tuple[int, int, int]:
        """Upper bounds of the powers of x, y and z in the deviation by any one parameter: a term of a Legendre series
        or of the cross-effect, times a lever arm."""
        of_terms = [term.polynomial.degrees for term in self.cross_terms]
        x, y, z = (
            max(order, 2, *(degrees[axis] for degrees in of_terms)) + 1 for axis, order in enumerate(self.highest_order)
        )
        return x, y, z


def series_orders(error: str, highest: int) -> range:
    """Return the Legendre orders of the series of an error motion up to the highest order N. The lowest order is 2 for
    a straightness and 1 for all other error motions."""
    return range(2 if error_motion_kind(error) == "straightness" else 1, highest + 1)


def error_motion_kind(error: str) -> Literal["positioning", "straightness", "rotation"]:
    """Return the kind of an error motion, such as straightness or rotation, from its ISO name."""
    if error[1] in "ABC":
        return "rotation"
    return "positioning" if error[1] == error[2] else "straightness"


def _term(error: str, order: int) -> Parameter:
    kind = error_motion_kind(error)
    return Parameter(f"{error}[{order}]", error, order, "rad" if kind == "rotation" else "mm", kind)


def _cross_parameter(term: CrossTerm) -> Parameter:
    kind: ParameterKind = "cross_displacement" if term.unit == "mm" else "cross_rotation"
    return Parameter(term.name, CROSS, 0, term.unit, kind)


def _check_ranges(ranges_mm: Ranges) -> None:
    for axis, (low, high) in zip(AXES, ranges_mm, strict=True):
        if not (math.isfinite(low) and math.isfinite(high)):
            raise ModelError(f"range [{low}, {high}] is not finite", axis=axis)
        if not low < high:
            hint = "Write the lower limit first, then the upper one, in mm"
            raise ModelError(f"range [{low:g}, {high:g}] is empty or reversed", hint=hint, axis=axis)


def _check_orders(orders: Mapping[str, int]) -> None:
    unknown = sorted(set(orders) - set(ERROR_MOTIONS))
    if unknown:
        hint = f"The 18 error motions are {', '.join(ERROR_MOTIONS)}"
        raise ModelError(f"'{unknown[0]}' is not an error motion of a linear axis", hint=hint)
    for error in ERROR_MOTIONS:
        if error not in orders:
            raise ModelError("no Legendre order given", error=error)
        if not 0 <= orders[error] <= 30:
            raise ModelError(f"Legendre order {orders[error]} is outside 0 to 30", error=error)


def _check_cross_effect(terms: tuple[str, ...]) -> None:
    for term in terms:
        if term not in CROSS_TERMS:
            raise ModelError(f"unknown cross-effect term '{term}'", hint=f"Known: {', '.join(CROSS_TERMS)}")
        if terms.count(term) > 1:
            raise ModelError(f"cross-effect term '{term}' is listed twice")


def _check_structure(terms: tuple[CrossTerm, ...]) -> None:
    taken = [term.name for term in (*COLUMN_AND_RAM.values(), *terms)]
    for term in terms:
        if term.error not in ERROR_MOTIONS:
            raise ModelError(f"'{term.error}' is not an error motion of a linear axis", parameter=term.name)
        if not (term.name.startswith(f"{CROSS}[") and term.name.endswith("]")):
            raise ModelError(f"the name of a cross-effect must be {CROSS}[…], not '{term.name}'")
        if taken.count(term.name) > 1:
            raise ModelError(f"cross-effect term '{term.name}' is listed twice")


def motion_uncertainty(model: ErrorModel, covariance: Array) -> Mapping[str, float]:
    """Return the standard uncertainty (mm or rad) of each geometric error, keyed by its ISO 230-1 name.

    The uncertainty of an error motion (a Legendre series in the position of its axis) is the root mean square of its
    standard uncertainty over the range of this axis. The uncertainty of a squareness is that of its only parameter.
    `covariance`, shape (p, p), is the covariance of the p parameters of `model` or the matrix of their second moments.
    Only its diagonal is used, because Legendre polynomials of different orders are orthogonal over the range of the
    axis; the mean square of the polynomial of order k is 1 / (2 k + 1).
    """
    if covariance.shape != (model.size, model.size):
        raise DataError(f"the covariance has shape {covariance.shape}, but the model has {model.size} parameters")
    variance = np.maximum(np.diagonal(covariance), 0.0)
    found = {}
    for error in ERROR_MOTIONS:
        orders = np.array(series_orders(error, model.orders[error]), dtype=np.float64)
        found[error] = float(np.sqrt(np.sum(variance[model.block[error]] / (2.0 * orders + 1.0))))
    return found | {name: float(np.sqrt(variance[model.index(name)])) for name in SQUARENESS}
