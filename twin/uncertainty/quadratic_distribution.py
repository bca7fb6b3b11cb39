"""Distribution of a quadratic form of Gaussian variables, such as the mean square of an uncertain field.

Let x be a vector of Gaussian variables with the mean m and the covariance L Lᵀ. The quadratic form Q = xᵀAx + 2bᵀx + c
is then a sum of independent non-central squares,

    Q = c₀ + Σ λ_j (g_j + δ_j)²,    g_j standard normal,

with the weights λ_j, the shifts δ_j and the lower bound c₀. The moment generating function of Q is known, and the
probability that Q exceeds a value q is an inverse Laplace transform of this function. Imhof (Biometrika 48, 1961)
evaluates the transform along real frequencies. Here the path of integration is a parabola through the saddle point
(Rice, SIAM J. Sci. Stat. Comput. 1, 1980; Helstrom, IEEE Trans. AES 19, 1983). On this path the integrand does not
oscillate and decays fast. Both tails are accurate to many digits, and the accuracy does not depend on the number of
terms.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from twin.arrays import Array, as_vector
from twin.errors import DataError

_MIN_WEIGHT = 1e-12  # of the largest λ: smaller terms are replaced by their mean
_STEP = 0.15  # integration step in widths of the saddle: error below 1e-15
_NEGLIGIBLE = 1e-17  # of the value at the saddle point: the sum ends below it
_BLOCK = 64  # points of the path at a time
_MAX_BLOCKS = 60
_MAX_RISE = 1e-6  # rise of the exponent that disqualifies a path; rounding stays below
_NEGATIVE_TOLERANCE = 1e-9  # negative eigenvalue, relative to the largest, that rounding cannot explain
_BENDS = (0.05, 0.02, 0.005, 0.001)  # curvatures of the path in widths of the saddle; the first usable one is taken
_MIN_EXPONENT = -37.0  # exponent relative to the saddle below which a term is negligible
_MAX_PHASE_STEP = 0.7  # largest phase change in rad from one term to the next
_UNDERFLOW = -745.0  # logarithm of the smallest number: a tail below it is zero
_HINT = "use the covariance of an estimate exactly as it was written"

Complex = np.ndarray[Any, np.dtype[np.complex128]]


@dataclass(frozen=True)
class _Path:
    """Parabola s = `saddle` + i v + `bend` v² in the complex plane, sampled at intervals `step` of v. `top` is the
    exponent at the saddle."""

    saddle: float
    bend: float
    step: float
    top: float


@dataclass(frozen=True, eq=False)
class QuadraticDistribution:
    """Distribution of Q = c₀ + Σ λ_j (g_j + δ_j)², where the g_j are independent standard normal variables.

    `weights`, shape (k,), contains the positive weights λ_j, and `shifts`, shape (k,), the shifts δ_j. `least` is the
    lower bound c₀ of Q.
    """

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
        """Return the distribution of Q = xᵀ `form` x + 2 `linear`ᵀ x + `constant` for a Gaussian vector x of p
        variables.

        Q must not be negative for any x. `form` and `covariance` have shape (p, p); `linear` and `mean` have shape
        (p,). Some variables may have zero variance. Raises DataError if the covariance is zero, not finite, not
        symmetric, or gives a negative variance in some direction.
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
        """Return one distribution of Q = xᵀ `form` x + 2 `linear`ᵀ x + `constant` for each of several means of x.

        x is a Gaussian vector of p variables; each of the `means` has shape (p,). All distributions share the
        covariance L Lᵀ of x; `factor`, shape (p, p), is the matrix L.
        """
        size = len(factor)
        matrix = np.asarray(form, dtype=np.float64)
        if matrix.shape != (size, size):
            raise DataError(f"the form has shape {matrix.shape}, the covariance ({size}, {size})")
        centres = [as_vector(mean, size, "mean") for mean in means]
        slope = as_vector(linear, size, "linear part")
        values, vectors = np.linalg.eigh(factor.T @ matrix @ factor)
        top = float(values[-1])
        if top <= 0.0 or values[0] < -_NEGATIVE_TOLERANCE * top:
            raise DataError("the quadratic form is not a mean square", hint="it must be positive semi-definite")
        kept = values > _MIN_WEIGHT * top
        # A term λ (g + δ)² with a negligible λ is replaced by its mean. Its share that does not depend on g is part of
        # the value at the mean, so only λ is left to add.
        weights, dropped = values[kept], float(values[~kept].sum()) + constant
        # With x = m + L V g the form is Σ λ g² + 2 gᵀVᵀLᵀ(A m + b) + const; completing the squares gives δ and c₀.
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
        """Return the probability that the quadratic form Q is greater than `value`."""
        above = value - self.least
        if above <= 0.0:
            return 1.0
        if self.weights.size == 1:
            # P(|g + δ| > √(q/λ)): both tails of one Gaussian variable, without an integral
            edge, shift = math.sqrt(above / float(self.weights[0])), float(self.shifts[0])
            return 0.5 * (math.erfc((edge - shift) / math.sqrt(2.0)) + math.erfc((edge + shift) / math.sqrt(2.0)))
        if above >= self._mean_above:
            return self._tail(above, upper=True)
        return 1.0 - self._tail(above, upper=False)

    def at_most(self, value: float) -> float:
        """Return the probability that the quadratic form Q is at most `value`.

        A very small probability is also accurate; if it were computed as 1 - `exceeds(value)`, it would be lost by
        rounding.
        """
        return self._at_most(value - self.least)

    def quantile(self, probability: float) -> float:
        """Return the value that the quadratic form Q does not exceed with the given probability.

        Raises DataError if `probability` is not between 0 and 1.
        """
        if not 0.0 < probability < 1.0:
            raise DataError(f"the probability must lie between 0 and 1, not {probability}")
        # The bracket is sought by doubling and halving from the mean, above c₀, because Q cannot be smaller than c₀.
        upper = self._mean_above
        while self._at_most(upper) < probability:
            upper *= 2.0
        lower = 0.5 * upper
        while self._at_most(lower) > probability:
            lower *= 0.5
        root = root_between(lambda above: self._at_most(above) - probability, lower, upper, 1e-13 * lower)
        return self.least + root

    def _at_most(self, above: float) -> float:
        """Return the probability that Q - c₀ ≤ above."""
        if above <= 0.0:
            return 0.0
        if above < self._mean_above:
            return self._tail(above, upper=False)
        return 1.0 - self._tail(above, upper=True)

    def _tail(self, above: float, *, upper: bool) -> float:
        """Return P(Q - c₀ > above) or, for the lower tail, P(Q - c₀ ≤ above), as one integral along a parabola.

        On the parabola s = saddle + i v + bend v² the exponent is K(s) - s above - log(±s), where K is the cumulant
        generating function. All singularities of K lie on the real axis to the right of the saddle, and the parabola
        passes around them for any bend. The first bend along which the terms decay is used.
        """
        if upper and self._chernoff_exponent(above) < _UNDERFLOW:
            return 0.0  # the saddle would be a pole to within rounding
        sign = 1.0 if upper else -1.0
        saddle = self._upper_saddle(above) if upper else self._lower_saddle(above)
        width = 1.0 / math.sqrt(self._curvature(saddle))
        top = float(self._exponent(np.array([saddle + 0j]), above, sign)[0].real)
        for bend in _BENDS:
            total = self._sum_along(_Path(saddle, bend / width, _STEP * width, top), above, sign)
            if total is not None:
                # P = 1/(2πi) ∫ exp(exponent) ds. The two halves of the path are complex conjugates, so twice the real
                # part of the upper half is summed: dv/π times the sum.
                return min(max(math.exp(top) * _STEP * width / math.pi * total, 0.0), 1.0)
        raise DataError("the distribution of this quadratic form cannot be integrated", hint=_HINT)

    def _chernoff_exponent(self, above: float) -> float:
        """Return an upper bound of the logarithm of P(Q - c₀ > above): K(s) - s above (Chernoff) halfway to the nearest
        pole, at s = 1 / (4 λ) for the largest weight λ."""
        half = 0.5 * self.weights / self.weights.max()
        cumulants = 0.5 * (self.shifts**2 * half / (1.0 - half) - np.log1p(-half)).sum()
        return float(cumulants - 0.25 * above / self.weights.max())

    def _sum_along(self, path: _Path, above: float, sign: float) -> float | None:
        """Return the sum of the integrand in units of its value at the saddle point.

        Return None if the integrand does not decay steadily or its phase turns faster than the steps can follow.
        """
        total, lowest = -0.5, 0.0  # the trapezoidal rule counts the first point half
        for block in range(_MAX_BLOCKS):
            v = path.step * (_BLOCK * block + np.arange(_BLOCK))
            s = np.asarray(path.saddle + 1j * v + path.bend * v**2, dtype=np.complex128)
            exponent = self._exponent(s, above, sign) - path.top
            # Each point is compared with the lowest value so far: a path that climbs again passes another saddle or a
            # pole.
            falling = np.minimum.accumulate(np.append(lowest, exponent.real))
            turned = np.abs(np.diff(exponent.imag))[exponent.real[1:] > _MIN_EXPONENT]
            if (exponent.real > falling[1:] + _MAX_RISE).any() or (turned > _MAX_PHASE_STEP).any():
                return None
            terms = np.exp(exponent) * (1.0 - 2j * path.bend * v)  # ds = i (1 - 2 i bend v) dv
            total += float(terms.real.sum())
            lowest = float(falling[-1])
            if float(np.abs(terms[-1])) < _NEGLIGIBLE:
                return total
        return None

    def _exponent(self, path: Complex, above: float, sign: float) -> Complex:
        """Return K(s) - s above - log(±s) at the points s = `path`, with the cumulants K of Q - c₀: the sum over j of
        -½ log(1 - z) + ½ δ² z / (1 - z) with z = 2 s λ = x + i y. In real parts, which are much faster than complex
        logarithms, |1 - z|² = 1 + x² + y² - 2 x and z / (1 - z) = (z - |z|²) / |1 - z|².
        """
        x, y = (2.0 * np.multiply.outer(part, self.weights) for part in (path.real, path.imag))
        size = x**2 + y**2
        distance = size - 2.0 * x
        growth = 0.5 * self.shifts**2 / (1.0 + distance)
        real = (x - size) * growth - 0.25 * np.log1p(distance)
        imaginary = y * growth + 0.5 * np.arctan2(y, 1.0 - x)
        cumulants = real.sum(axis=-1) + 1j * imaginary.sum(axis=-1)
        return np.asarray(cumulants - path * above - np.log(sign * path))

    def _slope(self, s: float, above: float) -> float:
        """Return the derivative of the exponent at real s."""
        left = 1.0 - 2.0 * s * self.weights
        return float((self.weights / left * (1.0 + self.shifts**2 / left)).sum()) - above - 1.0 / s

    def _upper_saddle(self, above: float) -> float:
        """Return the saddle between zero and the pole of the largest λ, where the slope rises from -∞ to ∞."""
        largest = float(self.weights.max())
        pole = 0.5 / largest
        middle = 0.5 * pole
        # `low` has a negative slope: K' rises with s, so K'(low) ≤ K'(middle) ≤ 1/low.
        low = min(middle, 1.0 / (self._slope(middle, 0.0) + 1.0 / middle))
        # `high` has a positive slope: there the term of the largest λ alone gives K' ≥ 2 above + 8 λ, and 1/s < 3 λ.
        high = pole * (1.0 - 0.5 * largest / (above + 4.0 * largest))
        return root_between(lambda s: self._slope(s, above), low, high)

    def _lower_saddle(self, above: float) -> float:
        """Return the saddle left of zero, where the slope rises from -above to ∞."""
        # `high` has a positive slope: left of zero K' > 0 and -1/s = 2 above.
        high = -0.5 / above
        low = 2.0 * high
        while self._slope(low, above) > 0.0:
            low *= 2.0
        return root_between(lambda s: self._slope(s, above), low, high)

    def _curvature(self, saddle: float) -> float:
        """Return the second derivative of the exponent at the saddle point."""
        left = 1.0 - 2.0 * saddle * self.weights
        ratio, swelling = self.weights / left, self.shifts**2 / left
        return float((2.0 * ratio**2 * (1.0 + 2.0 * swelling)).sum()) + saddle**-2


def root_between(function: Callable[[float], float], low: float, high: float, tolerance: float = 2e-12) -> float:
    """Return the argument between `low` and `high` at which `function` is zero, to within `tolerance`, by Brent's
    method. The function must have different signs at both ends."""
    # Takes 0.3 s to import, and most commands compute no limits.
    from scipy.optimize import brentq  # noqa: PLC0415

    return float(brentq(function, low, high, xtol=tolerance))


def covariance_factor(covariance: ArrayLike) -> Array:
    """Return a matrix L, shape (p, p), whose product L Lᵀ is `covariance`.

    Some variables may have zero variance. Raises DataError if the covariance is invalid or zero; the error names the
    row if a single row is at fault.
    """
    matrix = np.asarray(covariance, dtype=np.float64)
    if matrix.ndim != 2 or matrix.shape[0] != matrix.shape[1] or not np.isfinite(matrix).all():
        raise DataError(f"a covariance must be a finite square matrix, this one has shape {matrix.shape}")
    variance = np.diagonal(matrix)
    if (variance < 0.0).any():
        raise DataError("a variance is negative", row=int(np.argmin(variance)), hint=_HINT)
    if not variance.any():
        raise DataError("the covariance is zero, so there is no distribution to compute", hint=_HINT)
    # The decomposition works on correlations: mm² and rad² differ by many orders, and the small ones would be lost in
    # the rounding of the large ones.
    scale = np.where(variance > 0.0, np.sqrt(variance), 1.0)
    correlation = matrix / np.multiply.outer(scale, scale)
    off = np.abs(correlation - correlation.T).max(axis=1)
    if off.max() > _NEGATIVE_TOLERANCE:
        raise DataError("the covariance is not symmetric", row=int(np.argmax(off)), hint=_HINT)
    try:
        # ten times as fast as the eigenvectors, which are only needed if some direction has no variance
        return np.asarray(scale[:, None] * np.linalg.cholesky(correlation))
    except np.linalg.LinAlgError:
        values, vectors = np.linalg.eigh(correlation)
    if values[0] < -_NEGATIVE_TOLERANCE * values[-1]:
        raise DataError(
            "the covariance is not positive semi-definite: in some direction its variance is negative", hint=_HINT
        )
    return np.asarray(scale[:, None] * vectors * np.sqrt(np.maximum(values, 0.0)))
