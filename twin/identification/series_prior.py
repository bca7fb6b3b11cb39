"""Prior of the error motions: independent Legendre coefficients of the family, plus errors that are equally rough
everywhere.

Independent coefficients describe errors that grow towards the ends of the travel, because every Legendre polynomial is
1 or -1 there. The errors of a rail made of several pieces, or of a screw, do not grow: they are stationary along the
travel. Their Legendre coefficients are correlated, which keeps the ends as small as the middle. The covariance along
the axis is that of Matérn with the exponent 3/2 (Rasmussen and Williams 2006, 4.2). The covariance of a series is
therefore a sum of both parts. Each part has a scale of its own for each axis, which the measurements determine: the
rails of one axis may be made of several pieces and those of another of one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any

import numpy as np

from twin.arrays import Array
from twin.machine.error_model import ErrorModel, series_orders
from twin.machine.kinematic_chain import AXES

_NODES = 60
_LENGTH = 1.0  # correlation length of the stationary part on the axis normalised to [-1, 1]: half of the travel
STATIONARY_SHARE = 0.5
"""Rms of the stationary part relative to the independent part, both at scale 1."""

Mask = np.ndarray[Any, np.dtype[np.bool_]]
Numbers = np.ndarray[Any, np.dtype[np.int64]]


@dataclass(frozen=True, eq=False)
class PrincipalSeries:
    """Prior of the error motions for P unknowns in the principal axes of its stationary part.

    `axis` (P,) contains the number of the axis whose error motion an unknown belongs to, and -1 for all other unknowns.
    `stationary` (P,) contains the variances of the stationary part at scale 1, and zero for all other unknowns.
    """

    axis: Numbers
    stationary: Array


@dataclass(frozen=True, eq=False)
class SeriesPrior:
    """Covariance of the stationary part of the p parameters of a model, in units of their prior standard deviations.

    `index` (B, n) contains the parameters of each of B series, and the mask `used` (B, n) marks the entries that are
    not padding. `kernel` (B, n, n) is the covariance of each series at scale 1, zero where there is padding. `axis`
    (B,) contains the number of the axis that each series belongs to.
    """

    index: Numbers
    used: Mask
    kernel: Array
    axis: Numbers

    @classmethod
    def of(cls, model: ErrorModel, scale: Array) -> SeriesPrior:
        """Return the prior for a model whose parameters have the prior standard deviations `scale` (p,) in mm or rad.

        A series with a parameter that is held at zero has no stationary part.
        """
        series = [
            (AXES.index(error[2]), block, list(series_orders(error, model.orders[error])))
            for error, block in model.block.items()
            if block.stop > block.start and (scale[block] > 0.0).all()
        ]
        most = max((len(orders) for _, _, orders in series), default=1)
        index = np.zeros((len(series), most), dtype=np.int64)
        used = np.zeros((len(series), most), dtype=bool)
        kernel = np.zeros((len(series), most, most))
        for row, (_, block, orders) in enumerate(series):
            count = len(orders)
            index[row, :count], used[row, :count] = np.arange(block.start, block.stop), True
            projected = projected_kernel(max(orders) + 1, _LENGTH)[np.ix_(orders, orders)]
            mean_square = 1.0 / (2.0 * np.array(orders) + 1.0)  # of a Legendre polynomial over the travel
            size = (
                STATIONARY_SHARE**2
                * float(mean_square @ scale[block] ** 2)
                / float(mean_square @ np.diagonal(projected))
            )
            kernel[row, :count, :count] = size * projected / np.multiply.outer(scale[block], scale[block])
        return cls(index, used, kernel, np.array([axis for axis, _, _ in series], dtype=np.int64))

    @cached_property
    def principal(self) -> tuple[Array, Array]:
        """Variances (B, n) of the stationary part along its principal axes at scale 1, and these axes as the columns of
        rotations (B, n, n)."""
        values, axes = np.linalg.eigh(self.kernel)
        return np.maximum(values, 0.0), axes

    def precision(self, independent: Sequence[float], stationary: Sequence[float]) -> Array:
        """Return the precision (B, n, n) of each series for the scales of both parts, each given for X, Y and Z."""
        axes = self.principal[1]
        return np.asarray((axes / self._variances(independent, stationary)[:, None, :]) @ axes.transpose(0, 2, 1))

    def log_determinant(self, independent: Sequence[float], stationary: Sequence[float]) -> float:
        """Return the log determinant of the precision of all series for the scales of both parts."""
        return -float(np.log(self._variances(independent, stationary)[self._used_axes]).sum())

    def _variances(self, independent: Sequence[float], stationary: Sequence[float]) -> Array:
        """Return the variances (B, n) along the principal axes of each series."""
        own, equal = (np.square(scales)[self.axis, None] for scales in (independent, stationary))
        return np.asarray(own + equal * self.principal[0])

    def in_principal_axes(self, size: int) -> PrincipalSeries:
        """Return the same prior for `size` unknowns that have been turned to the principal axes."""
        found = np.zeros(size)
        found[self._numbers] = self.principal[0][self._used_axes]
        return PrincipalSeries(self.axes(size), found)

    def axes(self, size: int) -> Numbers:
        """Return the number (size,) of the axis that each of `size` unknowns belongs to; -1 for those of no series."""
        found = np.full(size, -1)
        found[self._numbers] = np.broadcast_to(self.axis[:, None], self.index.shape)[self.used]
        return found

    def rotation(self, size: int) -> Array:
        """Return the rotation T (size, size) that converts unknowns in principal axes to unknowns."""
        rotation = np.eye(size)
        for numbers, used, axes, taken in zip(self.index, self.used, self.principal[1], self._used_axes, strict=True):
            rotation[np.ix_(numbers[used], numbers[used])] = axes[np.ix_(used, taken)]
        return rotation

    @cached_property
    def _used_axes(self) -> Mask:
        """Mask (B, n) of the principal axes that are not those of padding."""
        padding = np.where(self.used, 0.0, 1.0)
        return np.asarray(np.einsum("bi,bij->bj", padding, self.principal[1] ** 2) < 0.5)

    @property
    def _numbers(self) -> Numbers:
        """Parameters of all series, in their order."""
        return np.asarray(self.index[self.used])

    def put_product(self, blocks: Array, matrix: Array, product: Array) -> None:
        """Write the products of `blocks` (B, n, n) and the rows of a matrix (P, m) that belong to each series into the
        same rows of `product` (P, m)."""
        rows = blocks @ (matrix[self.index] * self.used[:, :, None])
        product[self.index[self.used]] = rows[self.used]

    def parts(self, matrix: Array) -> Array:
        """Return the blocks (B, n, n) of a matrix (P, P) that belong to the series."""
        blocks = matrix[self.index[:, :, None], self.index[:, None, :]]
        return np.asarray(blocks * (self.used[:, :, None] & self.used[:, None, :]))


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
