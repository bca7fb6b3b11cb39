"""Prior of the scales of an identification, computed from covariances."""

from __future__ import annotations

import numpy as np


def prior_of_logs() -> np.ndarray:
    """Return the precision (12, 12) of all log scales, from the covariance of a chain of independent deviations: noise,
    family, mixed terms about the family, waves about the stationary part of their axis, and that about the family."""
    family, mixed, waves, axis, all_axes = np.log([30.0, 3.0, 2.0, 1.4, 2.0]) ** 2
    covariance = np.zeros((12, 12))
    covariance[0, 0] = np.log(3.0) ** 2
    covariance[1:, 1:] = family
    covariance[2, 2] += mixed
    for part in ([3, 4, 5, 6, 7, 8], [9, 10, 11]):
        covariance[np.ix_(part, part)] += all_axes
    for pair in ([3, 6], [4, 7], [5, 8], [9], [10], [11]):
        covariance[np.ix_(pair, pair)] += axis
    for wave in (3, 4, 5):
        covariance[wave, wave] += waves
    return np.asarray(np.linalg.inv(covariance))
