"""Curves of the machine's error functions and their uncertainty, computed from the parameters and the covariance of an
estimate."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from agent.reports.page.number_format import COVERAGE
from twin.arrays import Array
from twin.machine.error_model import ERROR_MOTIONS, ErrorModel, series_orders
from twin.machine.kinematic_chain import AXES
from twin.machine.legendre import legendre_values, normalise_positions
from twin.units import MICRO_UNITS

SAMPLES = 81
SQUARENESSES = ("C0Y", "B0Z", "A0Z")
"""Squareness errors. Among the 21 errors of ISO 230-1 only these three consist of a single number."""


@dataclass(frozen=True)
class ErrorCurve:
    """Error function `value` and its standard uncertainty `sigma` at n axis positions `position_mm`. All three are
    arrays (n,). `covariance` (n, n) is that of `value`, in the square of `unit`, which is µm or µrad."""

    name: str
    argument: str
    unit: str
    position_mm: Array
    value: Array
    covariance: Array

    def __post_init__(self) -> None:
        if self.covariance.shape != 2 * self.value.shape:
            raise ValueError(f"{self.name}: covariance of shape {self.covariance.shape}")

    @property
    def sigma(self) -> Array:
        return np.sqrt(np.maximum(np.diagonal(self.covariance), 0.0))

    @property
    def expanded_uncertainty(self) -> Array:
        """Expanded uncertainty (n,) of `value`, k = 2."""
        return COVERAGE * self.sigma

    @property
    def reach(self) -> float:
        """Largest absolute value in the band of the expanded uncertainty about the curve, in `unit`."""
        return float(np.max(np.abs(self.value) + self.expanded_uncertainty))

    @property
    def range(self) -> tuple[float, float]:
        """Range R of the curve over the travel, as ISO 230-1 evaluates an error motion, and its expanded uncertainty U
        (k = 2), both in `unit`.

        R is the largest difference between two points. U is that of the pair of points for which the sum of difference
        and uncertainty is largest, so that no pair is likely to differ by more than R + U. It does not vanish for a
        curve that is flat only because nothing determines it.
        """
        difference, doubt = self._pairs
        return float(difference.max()), float(doubt[self.widest_pair])

    @property
    def widest_pair(self) -> tuple[int, int]:
        """Indices of the two points whose difference and its expanded uncertainty have the largest sum."""
        difference, doubt = self._pairs
        first, second = np.unravel_index(int(np.argmax(difference + doubt)), difference.shape)
        return int(first), int(second)

    @property
    def _pairs(self) -> tuple[Array, Array]:
        """Absolute difference of each pair of points, and its expanded uncertainty (k = 2), both (n, n)."""
        variance = np.diagonal(self.covariance)
        squares = np.add.outer(variance, variance) - 2.0 * self.covariance
        return np.abs(np.subtract.outer(self.value, self.value)), COVERAGE * np.sqrt(np.maximum(squares, 0.0))


def geometric_error_curves(model: ErrorModel, parameters: Array, covariance: Array) -> tuple[ErrorCurve, ...]:
    """Return the curves of the error motions: first all error motions of X, then all of Y, then all of Z.

    Error motions that have no coefficient in the error model are left out.
    """
    curves = (error_curve(model, parameters, covariance, name) for name in ERROR_MOTIONS)
    return tuple(curve for curve in curves if curve is not None)


def error_curve(model: ErrorModel, parameters: Array, covariance: Array, name: str) -> ErrorCurve | None:
    """Return the curve of the error motion `name`, or None if it has no coefficient in the error model."""
    rows, block = _series_rows(model, name), model.block[name]
    if rows is None:
        return None
    return _curve(
        name,
        name[2],
        "rad" if name[1] in "ABC" else "mm",
        _positions(model, name[2]),
        rows=rows,
        coefficients=parameters[block],
        covariance=covariance[block, block],
    )


def range_gradient(model: ErrorModel, parameters: Array, covariance: Array, name: str) -> Array | None:
    """Return the derivatives (p,) of the difference of the two points of `ErrorCurve.widest_pair` of the error motion
    `name` with respect to the p parameters; None if it has no coefficient in the error model."""
    rows, curve = _series_rows(model, name), error_curve(model, parameters, covariance, name)
    if rows is None or curve is None:
        return None
    first, second = curve.widest_pair
    gradient = np.zeros(model.size)
    gradient[model.block[name]] = rows[first] - rows[second]
    return gradient


def _positions(model: ErrorModel, axis: str) -> Array:
    return np.linspace(*model.ranges_mm[AXES.index(axis)], SAMPLES)


def _series_rows(model: ErrorModel, name: str) -> Array | None:
    """Return the values (n, k) of the k Legendre polynomials of an error motion at the n points of its curve."""
    orders = series_orders(name, model.orders[name])
    if not len(orders):
        return None
    limits = model.ranges_mm[AXES.index(name[2])]
    return legendre_values(normalise_positions(_positions(model, name[2]), limits), orders[-1])[orders.start :].T


def cross_effect_curves(model: ErrorModel, parameters: Array, covariance: Array) -> tuple[ErrorCurve, ...]:
    """Return the curves of the contributions of the cross-effect to the error motions, as functions of the axis of each
    error motion. The other axes are at the upper ends of their ranges; a ram is then fully extended.

    The result is empty if the error model has no cross-effect.
    """
    curves = []
    for error in dict.fromkeys(term.error for term in model.cross_terms):
        axis = AXES.index(error[2])
        terms = [term for term in model.cross_terms if term.error == error]
        fractions = [np.linspace(0.0, 1.0, SAMPLES) if axis == other else np.ones(SAMPLES) for other in range(3)]
        rows = np.stack([term.polynomial.at(fractions) for term in terms], axis=1)
        chosen = [model.index(term.name) for term in terms]
        curves.append(
            _curve(
                f"E_{error[1:]}",
                error[2],
                terms[0].unit,
                _positions(model, error[2]),
                rows=rows,
                coefficients=parameters[chosen],
                covariance=covariance[np.ix_(chosen, chosen)],
            )
        )
    return tuple(curves)


def _curve(
    name: str, argument: str, unit: str, place: Array, *, rows: Array, coefficients: Array, covariance: Array
) -> ErrorCurve:
    """Return the curve of `rows` (n, k) weighted by `coefficients` (k,) with its covariance."""
    micro, scale = MICRO_UNITS[unit]
    # propagation of the coefficients' covariance: R C Rᵀ
    return ErrorCurve(
        name, argument, micro, place, scale * (rows @ coefficients), scale**2 * rows @ covariance @ rows.T
    )
