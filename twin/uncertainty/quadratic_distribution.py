"""The distribution of a quadratic form of Gaussian variables, such as the mean square of an uncertain field.

With x of mean m and covariance L Lᵀ the form xᵀAx + 2bᵀx + c is a sum of independent non-central squares,

    Q = c₀ + Σ λ_j (g_j + δ_j)²,    g_j standard normal,

whose moment generating function is known. The probability that Q exceeds q is its inverse Laplace transform (Imhof,
Biometrika 48, 1961, with real frequencies). Here the path of integration is a parabola through the saddle point (Rice,
SIAM J. Sci. Stat. Comput. 1, 1980; Helstrom, IEEE Trans. AES 19, 1983): what is summed neither oscillates nor decays
slowly, both tails are good to many digits, and one term or ninety make no difference.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import brentq

from twin.arrays import Array, as_vector
from twin.errors import DataError

_DROPPED = 1e-12  # of the largest λ: what is below moves the whole by no more than its mean
_STEP = 0.15  # of the integration, in widths of the saddle: leaves less than 1e-15
_ENDED = 1e-17  # of the value at the saddle point
_BLOCK = 64  # points of the path at a time
_MOST_BLOCKS = 60
_RISING = 1e-6  # of the exponent along a path that is no good: rounding is less
_IMPOSSIBLE = 1e-9  # a negative eigenvalue, of the largest, that is no rounding
_BENDS = (0.05, 0.02, 0.005, 0.001)  # of the path, in widths of the saddle; the first that does is taken
_COUNTS = -37.0  # exponent relative to that at the saddle, below which a summand is rounding
_TURNING = 0.7  # rad of a summand to the next one
_HINT = "take the covariance of an estimate as it was written"

Complex = np.ndarray[Any, np.dtype[np.complex128]]


@dataclass(frozen=True)
class _Path:
    """Parabola s = `saddle` + i v + `bend` v², taken in steps of v."""

    saddle: float
    bend: float
    step: float


@dataclass(frozen=True, eq=False)
class QuadraticDistribution:
    """`weights` λ (k,) above zero, `shifts` δ (k,), `least` c₀: Q is never below it."""

    weights: Array
    shifts: Array
    least: float

    @classmethod
    def of(
        cls,
        form: ArrayLike,
        linear: ArrayLike,
        constant: float,
        mean: ArrayLike,
        covariance: ArrayLike,
    ) -> QuadraticDistribution:
        """Of xᵀ form x + 2 linearᵀ x + constant, a mean square and so never negative, for Gaussian x.

        `form`, `covariance` (p, p), `linear`, `mean` (p,). A variable without uncertainty is no error; DataError for a
        covariance that is none (not finite, not symmetric, a negative variance in some direction) or zero altogether.
        """
        return cls.about(form, linear, constant, (mean,), covariance_factor(covariance))[0]

    @classmethod
    def about(
        cls,
        form: ArrayLike,
        linear: ArrayLike,
        constant: float,
        means: Sequence[ArrayLike],
        factor: Array,
    ) -> tuple[QuadraticDistribution, ...]:
        """One for each of several means (p,), for a covariance of which `factor` (p, p) is known."""
        size = len(factor)
        matrix = np.asarray(form, dtype=np.float64)
        if matrix.shape != (size, size):
            raise DataError(f"the form has shape {matrix.shape}, the covariance ({size}, {size})")
        centres = [as_vector(mean, size, "mean") for mean in means]
        slope = as_vector(linear, size, "linear part")
        values, vectors = np.linalg.eigh(factor.T @ matrix @ factor)
        top = float(values[-1])
        if top <= 0.0 or values[0] < -_IMPOSSIBLE * top:
            raise DataError("the quadratic form is no mean square", hint="it must be positive semi-definite")
        kept = values > _DROPPED * top
        weights, dropped = values[kept], float(values[~kept].sum()) + constant
        found = []
        for centre in centres:
            gradient = vectors.T @ (factor.T @ (matrix @ centre + slope))
            shifts = gradient[kept] / weights
            at_mean = float(centre @ matrix @ centre + 2.0 * (slope @ centre))
            found.append(cls(weights, shifts, max(at_mean + dropped - float(weights @ shifts**2), 0.0)))
        return tuple(found)

    @property
    def mean(self) -> float:
        return self.least + self._mean_above

    @cached_property
    def _mean_above(self) -> float:
        return float(self.weights @ (1.0 + self.shifts**2))

    @property
    def variance(self) -> float:
        return 2.0 * float(self.weights**2 @ (1.0 + 2.0 * self.shifts**2))

    def exceeds(self, value: float) -> float:
        """Probability that Q > value."""
        above = value - self.least
        if above <= 0.0:
            return 1.0
        if above >= self._mean_above:
            return self._tail(above, upper=True)
        return 1.0 - self._tail(above, upper=False)

    def at_most(self, value: float) -> float:
        """Probability that Q ≤ value, exact in the lower tail where 1 - `exceeds` would be rounding."""
        return self._at_most(value - self.least)

    def quantile(self, probability: float) -> float:
        """Value that Q stays below with this probability. DataError unless it lies between 0 and 1."""
        if not 0.0 < probability < 1.0:
            raise DataError(f"a probability between 0 and 1 is wanted, not {probability}")
        upper = self._mean_above
        while self._at_most(upper) < probability:
            upper *= 2.0
        lower = 0.5 * upper
        while self._at_most(lower) > probability:
            lower *= 0.5
        root: float = brentq(lambda above: self._at_most(above) - probability, lower, upper, xtol=1e-13 * lower)
        return self.least + root

    def _at_most(self, above: float) -> float:
        """Probability that Q - c₀ ≤ above."""
        if above <= 0.0:
            return 0.0
        if above < self._mean_above:
            return self._tail(above, upper=False)
        return 1.0 - self._tail(above, upper=True)

    def _tail(self, above: float, *, upper: bool) -> float:
        """P(Q - c₀ > above) or, for the lower tail, P(Q - c₀ ≤ above): one integral along a parabola.

        s = saddle + i v + bend v²; the exponent is K(s) - s above - log(±s), K the cumulant generating function. All
        its singularities lie on the real axis right of the saddle, where the parabola goes around them, whatever its
        bend; the first bend along which the summands fall off is as good as any other.
        """
        sign = 1.0 if upper else -1.0
        saddle = self._upper_saddle(above) if upper else self._lower_saddle(above)
        width = 1.0 / math.sqrt(self._curvature(saddle))
        for bend in _BENDS:
            total = self._sum_along(_Path(saddle, bend / width, _STEP * width), above, sign)
            if total is not None:
                top = float(self._exponent(np.array([saddle + 0j]), above, sign)[0].real)
                return min(max(math.exp(top) * _STEP * width / math.pi * total, 0.0), 1.0)
        raise DataError("the distribution of this quadratic form cannot be integrated", hint=_HINT)

    def _sum_along(self, path: _Path, above: float, sign: float) -> float | None:
        """Sum of the integrand in units of that at the saddle point; None where it does not fall off steadily or turns
        faster than the steps follow."""
        total, lowest = -0.5, 0.0  # the trapezoidal rule counts the first point half
        top = float(self._exponent(np.array([path.saddle + 0j]), above, sign)[0].real)
        for block in range(_MOST_BLOCKS):
            v = path.step * (_BLOCK * block + np.arange(_BLOCK))
            s = np.asarray(path.saddle + 1j * v + path.bend * v**2, dtype=np.complex128)
            exponent = self._exponent(s, above, sign) - top
            falling = np.minimum.accumulate(np.append(lowest, exponent.real))
            turned = np.abs(np.diff(exponent.imag))[exponent.real[1:] > _COUNTS]
            if (exponent.real > falling[1:] + _RISING).any() or (turned > _TURNING).any():
                return None
            terms = np.exp(exponent) * (1.0 - 2j * path.bend * v)
            total += float(terms.real.sum())
            lowest = float(falling[-1])
            if float(np.abs(terms[-1])) < _ENDED:
                return total
        return None

    def _exponent(self, path: Complex, above: float, sign: float) -> Complex:
        scaled = 2.0 * np.multiply.outer(path, self.weights)
        cumulants = -0.5 * np.log1p(-scaled) + 0.5 * self.shifts**2 * scaled / (1.0 - scaled)
        return np.asarray(cumulants.sum(axis=-1) - path * above - np.log(sign * path))

    def _slope(self, s: float, above: float) -> float:
        """Derivative of the exponent at real s."""
        left = 1.0 - 2.0 * s * self.weights
        return float((self.weights / left * (1.0 + self.shifts**2 / left)).sum()) - above - 1.0 / s

    def _upper_saddle(self, above: float) -> float:
        """Between zero and the pole of the largest λ, where the slope goes from -∞ to ∞."""
        largest = float(self.weights.max())
        pole = 0.5 / largest
        middle = 0.5 * pole
        low = min(middle, 1.0 / (self._slope(middle, 0.0) + 1.0 / middle))
        high = pole * (1.0 - 0.5 * largest / (above + 4.0 * largest))
        return float(brentq(self._slope, low, high, args=(above,)))

    def _lower_saddle(self, above: float) -> float:
        """Left of zero, where the slope goes from -above to ∞."""
        high = -0.5 / above
        low = 2.0 * high
        while self._slope(low, above) > 0.0:
            low *= 2.0
        return float(brentq(self._slope, low, high, args=(above,)))

    def _curvature(self, saddle: float) -> float:
        """Second derivative of the exponent at the saddle point."""
        left = 1.0 - 2.0 * saddle * self.weights
        ratio, swelling = self.weights / left, self.shifts**2 / left
        return float((2.0 * ratio**2 * (1.0 + 2.0 * swelling)).sum()) + saddle**-2


def covariance_factor(covariance: ArrayLike) -> Array:
    """L (p, p) with L Lᵀ = covariance, variables of zero variance included.

    DataError, naming the variable where it can be named, for what is no covariance and for one that is zero.
    """
    matrix = np.asarray(covariance, dtype=np.float64)
    if matrix.ndim != 2 or matrix.shape[0] != matrix.shape[1] or not np.isfinite(matrix).all():
        raise DataError(f"a covariance must be a finite square matrix, this one has shape {matrix.shape}")
    variance = np.diagonal(matrix)
    if (variance < 0.0).any():
        raise DataError("a variance is negative", row=int(np.argmin(variance)), hint=_HINT)
    if not variance.any():
        raise DataError("the covariance is zero: nothing is uncertain, so nothing has a distribution", hint=_HINT)
    scale = np.where(variance > 0.0, np.sqrt(variance), 1.0)
    correlation = matrix / np.multiply.outer(scale, scale)
    off = np.abs(correlation - correlation.T).max(axis=1)
    if off.max() > _IMPOSSIBLE:
        raise DataError("the covariance is not symmetric", row=int(np.argmax(off)), hint=_HINT)
    values, vectors = np.linalg.eigh(correlation)
    if values[0] < -_IMPOSSIBLE * values[-1]:
        raise DataError(
            "the covariance is not positive semi-definite: in some direction its variance is negative", hint=_HINT
        )
    return np.asarray(scale[:, None] * vectors * np.sqrt(np.maximum(values, 0.0)))
