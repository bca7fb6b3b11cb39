"""Polynomials in the positions of the three linear axes, each as a fraction of its range."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import product
from typing import TypeAlias

import numpy as np
from numpy.polynomial.polynomial import polyder, polyroots, polyval

from twin.arrays import Array
from twin.immutable import Immutable
from twin.machine.kinematic_chain import AXES

Powers = tuple[int, int, int]
PolynomialVector: TypeAlias = "tuple[AxisPolynomial, AxisPolynomial, AxisPolynomial]"

_DIGITS = 12  # significant digits of a coefficient: two derivations of the same polynomial differ only beyond them
_ROUNDING = 1e-13
_GRID = 17  # values per axis at which the search for the largest value of a polynomial begins
_TIE = 1e-9  # relative difference of two values that only rounding distinguishes
_SWEEPS = 50


@dataclass(frozen=True)
class AxisPolynomial(Immutable):
    """Polynomial in x, y and z, the axis positions of X, Y and Z as fractions of their ranges: 0 at the lower end, 1 at
    the upper end.

    `terms` contains pairs of the powers of x, y and z and a coefficient, in ascending order of the powers, without
    zeros.
    """

    terms: tuple[tuple[Powers, float], ...] = ()

    @classmethod
    def of(cls, terms: Iterable[tuple[Powers, float]]) -> AxisPolynomial:
        """Return the sum of monomials, given as powers and coefficient in any order. A coefficient that is only the
        rounding error of a sum is zero."""
        summed: dict[Powers, list[float]] = {}
        for powers, coefficient in terms:
            summed.setdefault(powers, []).append(coefficient)
        totals = {powers: sum(parts) for powers, parts in summed.items()}
        rounding = {powers: _ROUNDING * sum(map(abs, parts)) for powers, parts in summed.items()}
        return cls(tuple(sorted((powers, value) for powers, value in totals.items() if abs(value) > rounding[powers])))

    @classmethod
    def constant(cls, value: float) -> AxisPolynomial:
        return cls.of([((0, 0, 0), value)])

    @classmethod
    def linear(cls, axis: int, at_low: float, slope: float) -> AxisPolynomial:
        """Return `at_low` + `slope` times the fraction of one axis."""
        first = (int(axis == 0), int(axis == 1), int(axis == 2))
        return cls.of([((0, 0, 0), at_low), (first, slope)])

    def __add__(self, other: AxisPolynomial) -> AxisPolynomial:
        return AxisPolynomial.of((*self.terms, *other.terms))

    def __mul__(self, other: AxisPolynomial | float) -> AxisPolynomial:
        if not isinstance(other, AxisPolynomial):
            return AxisPolynomial.of((powers, other * value) for powers, value in self.terms)
        return AxisPolynomial.of(
            ((p[0] + q[0], p[1] + q[1], p[2] + q[2]), one * two)
            for (p, one), (q, two) in product(self.terms, other.terms)
        )

    def inserted_into(self, coefficients: Sequence[float]) -> AxisPolynomial:
        """Return the polynomial c0 + c1 P + c2 P² + … of this polynomial P, by Horner's scheme."""
        total = AxisPolynomial()
        for coefficient in reversed(coefficients):
            total = total * self + AxisPolynomial.constant(coefficient)
        return total

    @property
    def degrees(self) -> Powers:
        """Highest power of x, of y and of z; 0 for an axis that does not occur."""
        highest = [max((powers[axis] for powers, _ in self.terms), default=0) for axis in range(3)]
        return highest[0], highest[1], highest[2]

    @property
    def axes(self) -> tuple[int, ...]:
        """Indices of the axes that occur."""
        return tuple(axis for axis, degree in enumerate(self.degrees) if degree)

    def only(self, axis: int, power: int | None = None, *, mixed: bool = True) -> AxisPolynomial:
        """Return the terms with `power` of one axis (None: any power). Terms that contain no other axis are left out if
        `mixed`."""
        others = [other for other in range(3) if other != axis]
        return AxisPolynomial(
            tuple(
                (powers, value)
                for powers, value in self.terms
                if (power is None or powers[axis] == power) and (not mixed or any(powers[other] for other in others))
            )
        )

    def at(self, fractions: Sequence[Array]) -> Array:
        """Return the values (n,) at the fractions x, y, z, three arrays (n,)."""
        total = np.zeros(np.shape(fractions[0]))
        for powers, coefficient in self.terms:
            value = np.full(total.shape, coefficient)
            for fraction, power in zip(fractions, powers, strict=True):
                for _ in range(power):
                    value *= fraction
            total += value
        return total

    def normalised(self) -> tuple[AxisPolynomial, float]:
        """Return the polynomial divided by its value of the largest magnitude within the ranges, and this value. A
        single monomial keeps its exact powers with the coefficient 1. Zero returns itself and 0."""
        if not self.terms:
            return self, 0.0
        if len(self.terms) == 1:
            ((powers, value),) = self.terms
            return AxisPolynomial(((powers, 1.0),)), value
        largest = self._largest()
        if largest == 0.0:
            return AxisPolynomial(), 0.0
        biggest = max(abs(value) for _, value in self.terms) / abs(largest)
        terms = ((powers, _rounded(value / largest, biggest)) for powers, value in self.terms)
        return AxisPolynomial.of(terms), largest

    def _largest(self) -> float:
        """Return the value of the largest magnitude within the ranges, the positive one of two that are equal."""
        used = [np.linspace(0.0, 1.0, _GRID) if degree else np.zeros(1) for degree in self.degrees]
        grid = [part.ravel() for part in np.meshgrid(*used, indexing="ij")]
        values = self.at(grid)
        starts = [[float(part[index]) for part in grid] for index in (int(np.argmax(values)), int(np.argmin(values)))]
        highest, lowest = self._climbed(starts[0], 1.0), self._climbed(starts[1], -1.0)
        return highest if highest >= -lowest * (1.0 - _TIE) else lowest

    def _climbed(self, start: Sequence[float], sign: float) -> float:
        """Return the maximum (`sign` 1) or minimum (-1) near the fractions `start`: one axis after the other is moved
        to the exact extremum along it, until nothing changes."""
        point, found = list(start), -np.inf
        for _ in range(_SWEEPS):
            before = found
            for axis in self.axes:
                coefficients = np.zeros(self.degrees[axis] + 1)
                for powers, value in self.terms:
                    others = [point[other] ** powers[other] for other in range(3) if other != axis]
                    coefficients[powers[axis]] += sign * value * others[0] * others[1]
                # a double root may have a small imaginary part; its real part is as good as any other candidate
                roots = polyroots(polyder(coefficients)).real
                candidates = np.clip(np.concatenate(([point[axis], 0.0, 1.0], roots)), 0.0, 1.0)
                heights = polyval(candidates, coefficients)
                best = int(np.argmax(heights))
                point[axis], found = float(candidates[best]), float(heights[best])
            if found - before <= _ROUNDING * abs(found):
                break
        return sign * found

    def __str__(self) -> str:
        """Text such as `y z² - 0.5 y`."""
        parts = []
        for powers, value in self.terms:
            letters = [f"{axis.lower()}{_EXPONENTS[power]}" for axis, power in zip(AXES, powers, strict=True) if power]
            size = f"{abs(value):.4g}"
            factors = letters if letters and size == "1" else [size, *letters]
            parts.append(("- " if value < 0.0 else "+ ") + " ".join(factors))
        return " ".join(parts).removeprefix("+ ") or "0"


_EXPONENTS = ("", "", *(str(power).translate(str.maketrans("0123456789", "⁰¹²³⁴⁵⁶⁷⁸⁹")) for power in range(2, 100)))


def _rounded(value: float, biggest: float) -> float:
    """Return `value` without the digits that lie below the rounding of the largest coefficient."""
    step = 10.0 ** (np.floor(np.log10(biggest)) - _DIGITS)
    return float(np.round(value / step) * step)


def polynomial_vector(parts: Sequence[AxisPolynomial]) -> PolynomialVector:
    x, y, z = parts
    return x, y, z


def constant_vector(values: Sequence[float]) -> PolynomialVector:
    return polynomial_vector([AxisPolynomial.constant(value) for value in values])


def unit_vector(axis: int) -> PolynomialVector:
    return polynomial_vector([AxisPolynomial.constant(float(axis == other)) for other in range(3)])


def vector_sum(one: PolynomialVector, two: PolynomialVector) -> PolynomialVector:
    return polynomial_vector([a + b for a, b in zip(one, two, strict=True)])


def vector_product(one: PolynomialVector, two: PolynomialVector) -> PolynomialVector:
    (a, b, c), (d, e, f) = one, two
    return polynomial_vector([b * f + c * e * -1.0, c * d + a * f * -1.0, a * e + b * d * -1.0])
