"""Normal equations, prior and posterior of the unknowns z that all positions of the artefact share. The poses of the
artefact have already been eliminated by projection."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from scipy.linalg.blas import dtrsm
from scipy.linalg.lapack import dpotrf, dpotri, dpotrs, dtrtri

from twin.arrays import Array
from twin.errors import SingularSet
from twin.identification.scales import Scales
from twin.identification.series_prior import Mask, Numbers, PrincipalSeries, SeriesPrior
from twin.identification.unknowns import UnknownBlocks


@dataclass(frozen=True, eq=False)
class NormalEquations:
    """Normal equations for minimising |A z - y|² over the P unknowns z (P,).

    The design matrix A and the right side y belong to `rows` independent equations with unit noise. `matrix` is AᵀA (P,
    P), `right` is Aᵀy (P,), and `square` is |y|².
    """

    matrix: Array
    right: Array
    square: float
    rows: int

    def plus(self, other: NormalEquations) -> NormalEquations:
        """Return the normal equations of both sets of equations together; they have the same unknowns."""
        return NormalEquations(
            self.matrix + other.matrix, self.right + other.right, self.square + other.square, self.rows + other.rows
        )

    def misfit_square(self, z: Array) -> float:
        """Return the sum of squares |A z - y|² of the equations with the design matrix A and the right side y, at the
        unknowns z."""
        return max(0.0, self.square - 2.0 * float(self.right @ z) + float(z @ self.matrix @ z))


@dataclass(frozen=True, eq=False)
class JointPrior:
    """Joint Gaussian prior of some of the P unknowns of an identification. The estimated scales do not apply to this
    prior.

    The mask `members` (P,) marks the unknowns that have the joint prior. `information_vector` (P,) is the product of
    the precision and the prior mean. `precision` (P, P) and `information_vector` are zero for all other unknowns.
    """

    members: np.ndarray[Any, np.dtype[np.bool_]]
    precision: Array
    information_vector: Array

    @classmethod
    def at_zero(cls, blocks: UnknownBlocks, precision: Array) -> JointPrior:
        """Return a joint prior of the p model parameters with mean zero and the given `precision` (p, p)."""
        members, full = np.zeros(blocks.size, dtype=bool), np.zeros((blocks.size, blocks.size))
        members[blocks.parameters] = True
        full[blocks.parameters, blocks.parameters] = precision
        return cls(members, full, np.zeros(blocks.size))

    def extended(self, count: int) -> JointPrior:
        """Return the prior of a vector z that has `count` further unknowns at its end, which are no members."""
        more = (0, count)
        return JointPrior(
            np.pad(self.members, more), np.pad(self.precision, (more, more)), np.pad(self.information_vector, more)
        )

    def in_principal_axes(self) -> tuple[JointPrior, Array]:
        """Return the same prior for its m members in principal axes, in which the precision is diagonal, and these axes
        as the columns of a rotation (m, m)."""
        inside = np.ix_(self.members, self.members)
        values, axes = np.linalg.eigh(self.precision[inside])
        precision, information_vector = np.zeros_like(self.precision), np.zeros_like(self.information_vector)
        precision[inside] = np.diag(np.maximum(values, 0.0))
        information_vector[self.members] = axes.T @ self.information_vector[self.members]
        return JointPrior(self.members, precision, information_vector), axes


@dataclass(frozen=True, eq=False)
class DirectInformation:
    """Equations B z = y in the P unknowns z with unit noise, beside those of the ball centres. The estimated scale of
    the touch noise does not apply to them, and they do not take part in the estimation of scales.

    `rows` (m, P) is B and `target` (m,) is y.
    """

    rows: Array
    target: Array

    @property
    def vector(self) -> Array:
        """Product Bᵀy (P,)."""
        return np.asarray(self.target @ self.rows)

    def extended(self, count: int) -> DirectInformation:
        """Return the equations for a vector z with `count` further unknowns at its end, which do not occur in them."""
        return DirectInformation(np.pad(self.rows, ((0, 0), (0, count))), self.target)


@dataclass(frozen=True, eq=False)
class PriorPrecision:
    """Prior precision of the unknowns z, given for prior standard deviations as stated (all scales equal to 1).

    Some unknowns may have the joint prior `known`. All others have mean zero and the unit matrix as precision, except
    the coefficients of the error motions if they have the prior `series`. If the unknowns have been turned to the
    principal axes of this prior, `principal` replaces `series`, and the prior precision is diagonal.

    `direct` are the readings of other instruments. They belong to the measurements and are no part of the prior
    precision; they are kept here because no scale applies to them. The posterior contains them.
    """

    blocks: UnknownBlocks
    known: JointPrior | None = None
    series: SeriesPrior | None = None
    principal: PrincipalSeries | None = None
    direct: DirectInformation | None = None

    def has_free_scale(self, block: slice) -> bool:
        """Return True if the scale of the unknowns in `block` can be estimated. The block must not be empty, and no
        unknown in it may have a joint prior."""
        return block.stop > block.start and (self.known is None or not self.known.members[block].any())

    @property
    def information_vector(self) -> Array:
        """Product (P,) of the prior precision and the prior mean of the P unknowns, with what the readings of other
        instruments add to it."""
        found = np.zeros(self.blocks.size) if self.known is None else self.known.information_vector
        return found if self.direct is None else found + self.direct.vector

    def matrix(self, scales: Scales) -> Array:
        """Return the prior precision (P, P) of the P unknowns for the given scales."""
        full = np.zeros((self.blocks.size, self.blocks.size))
        self.add_to(full, scales)
        return full

    def add_to(self, matrix: Array, scales: Scales) -> None:
        """Add the prior precision for the given scales to a matrix (P, P) in place."""
        diagonal = self.diagonal(scales)
        if self.known is not None:
            matrix += self.known.precision
            diagonal[self.known.members] = 0.0
        if self.series is not None:
            series = self.series
            diagonal[series.index[series.used]] = 0.0
            inside = series.used[:, :, None] & series.used[:, None, :]
            rows, columns = np.broadcast_arrays(series.index[:, :, None], series.index[:, None, :])
            matrix[rows[inside], columns[inside]] += series.precision(scales.independent, scales.stationary)[inside]
        np.einsum("ii->i", matrix)[:] += diagonal

    def diagonal(self, scales: Scales) -> Array:
        """Return the diagonal (P,) of the prior precision for the given scales, without the stationary part unless the
        unknowns are in principal axes."""
        diagonal = np.ones(self.blocks.size)
        diagonal[self.blocks.parameters] = scales.prior**-2
        if self.principal is not None:
            own, axis = self._in_series, self.principal.axis[self._in_series]
            independent, stationary = np.square(scales.independent), np.square(scales.stationary)
            diagonal[own] = 1.0 / (independent[axis] + stationary[axis] * self.principal.stationary[own])
        for kind, scale in zip(self.blocks.kinds, scales.kinds, strict=False):
            diagonal[kind] = scale**-2
        if self.known is not None:
            diagonal[self.known.members] = np.diagonal(self.known.precision)[self.known.members]
        return diagonal

    def times(self, matrix: Array, scales: Scales) -> Array:
        """Return the product of the prior precision (P, P) for the given scales and a matrix (P, m)."""
        if self.known is not None:
            return np.asarray(self.matrix(scales) @ matrix)
        product: Array = self.diagonal(scales)[:, None] * matrix
        if self.series is not None:
            self.series.put_product(self.series.precision(scales.independent, scales.stationary), matrix, product)
        return product

    def variance_changes(self, scales: Scales) -> Array:
        """Return the derivatives (11, P) of the prior variances of all unknowns with respect to the logarithms of the
        scales without that of the noise.

        The rows of the stationary parts are zero unless the unknowns are in principal axes.
        """
        # A variance s² changes by 2 s² with ln s. The rows are those of `Scales.values` without the noise: prior, four
        # kinds of misfit, stationary parts and independent coefficients of three axes. A scale that applies to no
        # unknown keeps a row of zeros, so that the caller can leave it out by its mask of free scales.
        changes = np.zeros((11, self.blocks.size))
        changes[0, self.blocks.parameters] = 2.0 * scales.prior**2
        # The variance of a coefficient of an error motion is independent² + stationary² q (see `diagonal`): the scale
        # of the prior does not occur in it.
        changes[0, self._in_series] = 0.0
        for axis, scale in enumerate(scales.independent):
            changes[8 + axis, self._axes == axis] = 2.0 * scale**2
        for row, (block, scale) in enumerate(zip(self.blocks.kinds, scales.kinds, strict=False), start=1):
            changes[row, block] = 2.0 * scale**2
        # Only in principal axes is the stationary part a variance of its own for each unknown.
        if self.principal is not None:
            for axis, scale in enumerate(scales.stationary):
                of_axis = self._axes == axis
                changes[5 + axis, of_axis] = 2.0 * scale**2 * self.principal.stationary[of_axis]
        return changes

    def log_determinant(self, scales: Scales) -> float:
        """Return the log determinant of the prior precision for the given scales. The constant part that belongs to a
        joint prior is left out."""
        alone = np.ones(self.blocks.size, dtype=bool)
        found = 0.0
        if self.known is not None:
            alone &= ~self.known.members
        if self.series is not None:
            alone &= ~self._in_series
            found = self.series.log_determinant(scales.independent, scales.stationary)
        return found + float(np.log(self.diagonal(scales)[alone]).sum())

    @cached_property
    def _axes(self) -> Numbers:
        """Number (P,) of the axis of each coefficient of an error motion that has the prior `series` or `principal`; -1
        for all other unknowns."""
        if self.principal is not None:
            return self.principal.axis
        return np.full(self.blocks.size, -1) if self.series is None else self.series.axes(self.blocks.size)

    @cached_property
    def _in_series(self) -> Mask:
        """Mask (P,) of the coefficients of error motions that have the prior `series` or `principal`."""
        return np.asarray(self._axes >= 0)


@dataclass(frozen=True, eq=False)
class Posterior:
    """Posterior of the P unknowns z, represented by its precision. `factor` (P, P) is the lower Cholesky factor of the
    precision, in Fortran order.

    If the prior standard deviations are as stated (scale 1), the prior alone gives a precision of 1 in every direction
    that the measurements leave open. An explicit inverse is therefore numerically safe.
    """

    factor: Array

    @classmethod
    def of(cls, matrix: Array, precision: PriorPrecision, scales: Scales) -> Posterior:
        weighted = matrix * scales.noise**-2
        precision.add_to(weighted, scales)
        if precision.direct is not None:
            weighted += precision.direct.rows.T @ precision.direct.rows
        factor, wrong = dpotrf(weighted.T, lower=1, clean=1, overwrite_a=1)  # its transpose is Fortran-ordered
        if wrong:
            raise SingularSet("the measurements do not determine the model", hint="switch the prior on")
        return cls(factor)

    @cached_property
    def log_determinant(self) -> float:
        """Logarithm of the determinant of the posterior precision."""
        return 2.0 * float(np.log(np.diagonal(self.factor)).sum())

    @cached_property
    def covariance(self) -> Array:
        """Posterior covariance (P, P) of the P unknowns."""
        # dpotri fills the lower triangle only; the upper one is zero, so the sum counts just the diagonal twice.
        lower, _ = dpotri(self.factor, lower=1)
        covariance: Array = lower + lower.T
        np.einsum("ii->i", covariance)[:] *= 0.5
        return covariance

    @cached_property
    def variances(self) -> Array:
        """Diagonal (P,) of the posterior covariance."""
        # (L Lᵀ)⁻¹ = L⁻ᵀ L⁻¹: its diagonal is the sum of squares in each column of L⁻¹, without the full inverse.
        inverse, _ = dtrtri(self.factor, lower=1)
        return np.asarray(np.einsum("ij,ij->j", inverse, inverse))

    def times(self, z: Array) -> Array:
        """Return the product (P,) of the posterior precision and z."""
        return np.asarray(self.factor @ (self.factor.T @ z))

    def solve(self, right: Array) -> Array:
        """Return the product of the posterior covariance and `right`, which has shape (P,) or (P, m)."""
        return np.asarray(dpotrs(self.factor, right, lower=1)[0])

    def whiten(self, rows: Array) -> Array:
        """Return a matrix W (n, P) with W Wᵀ = A C Aᵀ. Here A (n, P) is the matrix `rows`, and C is the posterior
        covariance."""
        return np.asarray(dtrsm(1.0, self.factor, rows.T, lower=1).T)
