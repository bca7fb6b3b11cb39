"""Standard uncertainty that an instrument states for a figure, by the propagation of distributions (JCGM 101)."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from twin.arrays import Array

DRAWS = 500
"""Draws of a statement: its standard uncertainty scatters by 3 %."""


def standard_uncertainty(
    figure: Callable[[Array], float], readings: Array, error: Callable[[np.random.Generator], Array], seed: int
) -> float:
    """Return the standard uncertainty of `figure(readings)` if the readings have an error drawn by `error`.

    It is the rms distance from the figure of the readings, not the standard deviation: a range grows with any error,
    and the statement must cover this too. `seed` selects the draws.
    """
    rng = np.random.default_rng([seed, DRAWS])
    stated = figure(readings)
    drawn = np.array([figure(readings + error(rng)) for _ in range(DRAWS)])
    return float(np.sqrt(np.mean((drawn - stated) ** 2)))
