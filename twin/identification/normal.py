"""The equations reduced to the few shared unknowns: normal equations with the poses already projected out."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from twin.arrays import Array
from twin.errors import SingularSet
from twin.identification.problem import Blocks


@dataclass(frozen=True, eq=False)
class Normal:
    """Σ|A z - y|² over `rows` independent equations of unit noise: AᵀA (P, P), Aᵀy (P,), |y|²."""

    matrix: Array
    right: Array
    square: float
    rows: int

    def misfit_square(self, z: Array) -> float:
        """|A z - y|²."""
        return max(0.0, self.square - 2.0 * float(self.right @ z) + float(z @ self.matrix @ z))


@dataclass(frozen=True)
class Scales:
    """Factors on the standard deviations of touch noise, parameter prior and misfit."""

    noise: float = 1.0
    prior: float = 1.0
    misfit: float = 1.0


@dataclass(frozen=True, eq=False)
class Precision:
    """Prior precision of z at scale 1: `parameters` (p, p) or None for the unit matrix; all else is the unit matrix."""

    blocks: Blocks
    parameters: Array | None = None

    def matrix(self, scales: Scales) -> Array:
        """(P, P)."""
        full = np.diag(self.diagonal(scales))
        if self.parameters is not None:
            full[self.blocks.parameters, self.blocks.parameters] = self.parameters
        return full

    def diagonal(self, scales: Scales) -> Array:
        """(P,) of the unit-matrix form."""
        diagonal = np.ones(self.blocks.size)
        diagonal[self.blocks.parameters] = scales.prior**-2
        diagonal[self.blocks.misfit] = scales.misfit**-2
        return diagonal


@dataclass(frozen=True, eq=False)
class Posterior:
    """Posterior of z: `covariance` (P, P) and the log determinant of its inverse.

    In unit-prior coordinates the precision is at least 1 in every direction that the measurements leave open, so the
    explicit inverse, which the result needs anyhow, loses nothing.
    """

    covariance: Array
    log_determinant: float

    @classmethod
    def of(cls, matrix: Array, precision: Precision, scales: Scales) -> Posterior:
        weighted = matrix / scales.noise**2 + precision.matrix(scales)
        try:
            factor = np.linalg.cholesky(weighted)
        except np.linalg.LinAlgError:
            message = "the measurements do not determine the model"
            raise SingularSet(message, hint="switch the prior on") from None
        inverse = np.linalg.inv(weighted)
        symmetric = 0.5 * (inverse + inverse.T)
        return cls(symmetric, 2.0 * float(np.log(np.diagonal(factor)).sum()))

    def solve(self, right: Array) -> Array:
        """Posterior mean for the weighted right-hand side (P,) or (P, m)."""
        return np.asarray(self.covariance @ right)
