"""Standard uncertainty of the 21 geometric errors from the covariance of their coefficients."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from twin.arrays import Array
from twin.errors import DataError
from twin.machine.error_model import ERROR_MOTIONS, SQUARENESS, ErrorModel, series_orders


def motion_uncertainty(model: ErrorModel, covariance: Array) -> Mapping[str, float]:
    """Return the standard uncertainty (mm or rad) of each geometric error by its ISO name.

    For an error motion it is the root mean square over the range of its axis; for a squareness it is the uncertainty of
    that parameter. `covariance` (p, p): covariance of the parameters, or the matrix of their second moments. The mean
    over the range of the product of the Legendre polynomials P_k P_l is zero for k ≠ l and 1 / (2 k + 1) for k = l, so
    only variances contribute.
    """
    if covariance.shape != (model.size, model.size):
        raise DataError(f"the covariance has shape {covariance.shape}, but the model has {model.size} parameters")
    variance = np.maximum(np.diagonal(covariance), 0.0)
    found = {}
    for error in ERROR_MOTIONS:
        orders = np.array(series_orders(error, model.orders[error]), dtype=np.float64)
        found[error] = float(np.sqrt(np.sum(variance[model.block[error]] / (2.0 * orders + 1.0))))
    return found | {name: float(np.sqrt(variance[model.index(name)])) for name in SQUARENESS}
