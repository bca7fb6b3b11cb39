"""Covariance of errors that are equally rough everywhere along an axis, projected onto Legendre polynomials.

The errors of a rail made of several pieces, or of a screw, do not grow towards the ends of the travel: they are
stationary. Their Legendre coefficients are correlated, which keeps the ends as small as the middle, although every
Legendre polynomial is 1 or -1 there. The covariance along the axis is that of Matérn with the exponent 3/2 (Rasmussen
and Williams 2006, 4.2).
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from twin.arrays import Array

_NODES = 60


@lru_cache(maxsize=32)
def projected_kernel(terms: int, length: float) -> Array:
    """Return the covariance (terms, terms) of the Legendre coefficients of the orders 0 to terms - 1 of a stationary
    error with unit variance. The correlation length `length` applies to the axis normalised to [-1, 1]."""
    nodes, weights = np.polynomial.legendre.leggauss(_NODES)
    distance = np.sqrt(3.0) * np.abs(nodes[:, None] - nodes) / length
    kernel = (1.0 + distance) * np.exp(-distance)
    # coefficient k of f is (2k + 1)/2 times the integral of f P_k
    projection = np.polynomial.legendre.legvander(nodes, terms - 1).T * weights
    projection *= (np.arange(terms) + 0.5)[:, None]
    return np.asarray(projection @ kernel @ projection.T)
