"""Curves of the machine's error functions and their uncertainty, computed from the parameters and the covariance of an
estimate."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from twin.arrays import Array
from twin.machine.error_model import DIRECTIONS, ErrorModel, series_orders
from twin.machine.legendre import legendre_values, normalise_positions
from twin.units import MICRO_UNITS

SAMPLES = 81
SQUARENESSES = ("C0Y", "B0Z", "A0Z")
"""Squareness errors. Among the 21 errors of ISO 230-1 only these three consist of a single number."""


@dataclass(frozen=True)
class ErrorCurve:
    """Error function `value` and its standard uncertainty `sigma` at n axis positions `position_mm`. All three are
    arrays (n,). `unit` is µm or µrad."""

    name: str
    argument: str
    unit: str
    position_mm: Array
    value: Array
    sigma: Array

    @property
    def reach(self) -> float:
        """Largest absolute value in the band of ±2 standard uncertainties (2σ) about the curve, in `unit`."""
        return float(np.max(np.abs(self.value) + 2.0 * self.sigma))


def geometric_error_curves(model: ErrorModel, parameters: Array, covariance: Array) -> tuple[ErrorCurve, ...]:
    """Return the curves of the error motions: first all error motions of X, then all of Y, then all of Z.

    Error motions that have no coefficient in the error model are left out.
    """
    curves = []
    for axis, limits in zip("XYZ", model.ranges_mm, strict=True):
        place = np.linspace(*limits, SAMPLES)
        for direction in DIRECTIONS:
            error = f"E{direction}{axis}"
            orders = series_orders(error, model.orders[error])
            if len(orders):
                rows = legendre_values(normalise_positions(place, limits), orders[-1])[orders.start :].T
                block = model.block[error]
                unit = "rad" if direction in "ABC" else "mm"
                curves.append(
                    _curve(
                        error,
                        axis,
                        unit,
                        place,
                        rows=rows,
                        coefficients=parameters[block],
                        covariance=covariance[block, block],
                    )
                )
    return tuple(curves)


def cross_effect_curves(model: ErrorModel, parameters: Array, covariance: Array) -> tuple[ErrorCurve, ...]:
    """Return the curves of the contributions of the cross-effect to the error motions EYZ and EAZ with the ram fully
    extended, as functions of Z.

    The result is empty if the error model has no cross-effect.
    """
    place = np.linspace(*model.ranges_mm[2], SAMPLES)
    w = (place - place[0]) / (place[-1] - place[0])
    curves = []
    for letter, error, unit in (("b", "E_YZ", "mm"), ("c", "E_AZ", "rad")):
        terms = [term for term in model.cross_effect if term[0] == letter]
        if terms:
            rows = np.stack([w ** int(term[1]) for term in terms], axis=1)
            chosen = [model.index(f"CROSS[{term}]") for term in terms]
            part = covariance[np.ix_(chosen, chosen)]
            curves.append(_curve(error, "Z", unit, place, rows=rows, coefficients=parameters[chosen], covariance=part))
    return tuple(curves)


def _curve(
    name: str, argument: str, unit: str, place: Array, *, rows: Array, coefficients: Array, covariance: Array
) -> ErrorCurve:
    """Return the curve of `rows` (n, k) weighted by `coefficients` (k,) with its standard uncertainty."""
    micro, scale = MICRO_UNITS[unit]
    # variance of each point by propagation of the coefficients' covariance: diag(R C Rᵀ)
    variance = np.einsum("nk,kl,nl->n", rows, covariance, rows)
    sigma = scale * np.sqrt(np.maximum(variance, 0.0))
    return ErrorCurve(name, argument, micro, place, scale * (rows @ coefficients), sigma)
