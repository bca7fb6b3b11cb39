"""Standard uncertainties of the 21 geometric errors, computed from the covariance of their coefficients."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from twin.arrays import Array
from twin.errors import DataError
from twin.machine.error_model import ERROR_MOTIONS, SQUARENESS, ErrorModel, series_orders


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
