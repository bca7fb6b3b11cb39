"""Seasons of a machine that wears, made without the code of the program.

A season is what a machine did in every night of two thirds of a year to two years, and what was measured of it in the
nights in which somebody measured. The true value is the sum of wear at a rate that changes suddenly several times (a
third of the machines do not wear), a random walk, and the cycles of week and year of the temperature. Measured values
scatter, some nights are outliers, single nights and whole weeks are missing. All amounts differ from season to season.
Nothing of it is taken from `twin`, and neither a walk with constant slope nor normal errors hold.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

DAYS_A_YEAR = 365.25


@dataclass(frozen=True, eq=False)
class MachineSeason:
    """Season of n nights of which m were measured.

    `true`, shape (n,), is the true value of each night in µm. `nights` and `measured`, shape (m,), are the measured
    nights and their values. `limit` is the tolerance of the absolute value in µm.
    """

    true: Array
    nights: Array
    measured: Array
    limit: float

    @property
    def passed(self) -> float:
        """Number of the first night in which the true value is at the tolerance, infinite if there is none."""
        beyond = np.flatnonzero(np.abs(self.true) >= self.limit)
        return float(beyond[0]) if beyond.size else float("inf")

    def until(self, night: float) -> tuple[Array, Array]:
        """Return the nights measured until then, and their values."""
        known = self.nights <= night
        return self.nights[known], self.measured[known]


def season(number: int) -> MachineSeason:
    """Return the season with this number, which is the seed of all that differs between seasons."""
    rng = np.random.default_rng([8, number])
    count = int(rng.integers(240, 720))
    nights = np.arange(count, dtype=np.float64)
    repeatability = float(np.exp(rng.uniform(np.log(0.15), np.log(1.0))))
    true = (
        rng.uniform(1.0, 4.0)
        + _wear(rng, count)
        + np.cumsum(rng.choice([0.0, 0.03, 0.08, 0.15]) * rng.standard_normal(count))
        + rng.uniform(0.0, 0.4) * np.sin(2.0 * np.pi * (nights / 7.0 + rng.uniform()))
        + rng.uniform(0.0, 1.5) * np.sin(2.0 * np.pi * (nights / DAYS_A_YEAR + rng.uniform()))
    )
    done = rng.uniform(size=count) > rng.choice([0.0, 0.1, 0.4, 0.7])
    for _ in range(int(rng.integers(0, 4))):  # weeks in which nobody measures
        first = int(rng.integers(0, count))
        done[first : first + int(rng.integers(5, 25))] = False
    errors = repeatability * rng.standard_t(5, count) * np.sqrt(3.0 / 5.0)
    outlying = rng.uniform(size=count) < rng.choice([0.0, 0.01, 0.03])
    errors = errors + outlying * rng.choice([-1.0, 1.0], count) * rng.uniform(4.0, 12.0, count) * repeatability
    return MachineSeason(true, nights[done], (true + errors)[done], float(rng.uniform(6.0, 14.0)))


def _wear(rng: np.random.Generator, count: int) -> Array:
    """Return the wear in µm in each of `count` nights: a broken line."""
    if rng.uniform() < 1.0 / 3.0:
        return np.zeros(count)
    kinks = np.sort(rng.integers(0, count, int(rng.integers(0, 4))))
    rates = float(np.exp(rng.uniform(np.log(0.005), np.log(0.12)))) * np.exp(0.7 * rng.standard_normal(len(kinks) + 1))
    return np.cumsum(rates[np.searchsorted(kinks, np.arange(count), side="right")])
