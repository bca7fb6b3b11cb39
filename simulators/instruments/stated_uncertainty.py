"""Standard uncertainty that an instrument states for a figure, by the propagation of distributions (JCGM 101)."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from twin.arrays import Array

DRAWS = 500
"""Draws of a statement: its standard uncertainty scatters by 3 %."""

_ONCE_MORE = float(np.sqrt(3.0))
"""The readings contain their scatter σ already, by which a range has grown in proportion to σ. Scatter of σ √3 on top
makes it 2 σ: the range then grows as much again as it had grown before, and this growth is in the statement."""

Figure = Callable[[Array], Array]
"""Function that takes readings (..., n) to their figures (...)."""


def draws_of(seed: int) -> np.random.Generator:
    """Return the generator of the errors that an instrument draws for its statement, apart from those that it has."""
    return np.random.default_rng([seed, DRAWS])


def factors(rng: np.random.Generator) -> Array:
    """Return standard normal factors (DRAWS, 1) of an error that all readings share."""
    return rng.standard_normal((DRAWS, 1))


def scatter(rng: np.random.Generator, readings: int) -> Array:
    """Return factors (DRAWS, n) of an error that is independent from reading to reading, of size `_ONCE_MORE`."""
    return _ONCE_MORE * rng.standard_normal((DRAWS, readings))


def standard_uncertainty(figure: Figure, readings: Array, errors: Array) -> float:
    """Return the standard uncertainty of the figure of n `readings` (n,) that have drawn `errors` (DRAWS, n).

    It is the rms distance from the figure of the readings, not the standard deviation: a range grows with any error,
    and the statement must cover this too.
    """
    return float(np.sqrt(np.mean((figure(readings + errors) - figure(readings)) ** 2)))


def range_of(readings: Array) -> Array:
    """Return the largest minus the smallest of readings (..., n)."""
    return np.asarray(np.ptp(readings, axis=-1))
