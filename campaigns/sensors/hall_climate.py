"""Temperatures of a hall and of the bodies of a machine in it, hour by hour, made without the code of the program.

The weather outside is a year, a day, and fronts that come and go; the hall follows it through its walls, is heated on
working days, and cools down over the weekend. Bed, column and ram follow the air with first-order lags of their own,
and the ram is warmed by the spindle on working days. A spindle head that no sensor sees does so too. All amounts differ
from machine to machine.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

BODIES = ("column", "ram", "bed", "air")
_HOURS_A_DAY, _DAYS_A_YEAR, _WORKING_DAYS = 24, 365.25, 5


@dataclass(frozen=True, eq=False)
class HallClimate:
    """True temperatures in °C of each hour (h,): those of the four bodies that have sensors, (h, 4) in the order of
    `BODIES`, and that of the head (h,), which has none."""

    bodies: Array
    head: Array


def hall_climate(rng: np.random.Generator, days: int) -> HallClimate:
    """Return the temperatures of so many days, after a fortnight in which the bodies have settled."""
    settling = 14
    hours = np.arange((days + settling) * _HOURS_A_DAY, dtype=np.float64)
    day = hours / _HOURS_A_DAY
    outside = (
        rng.uniform(5.0, 12.0) * np.sin(2.0 * np.pi * (day / _DAYS_A_YEAR + rng.uniform()))
        + rng.uniform(2.0, 5.0) * np.sin(2.0 * np.pi * (day + rng.uniform(0.5, 0.7)))
        + _fronts(rng, len(hours), rng.uniform(1.5, 3.5), rng.uniform(1.5, 5.0))
    )
    first = int(rng.integers(0, 7))
    working = ((day.astype(np.intp) + first) % 7 < _WORKING_DAYS).astype(np.float64)
    shift = working * ((hours % _HOURS_A_DAY >= 6) & (hours % _HOURS_A_DAY < 22))
    wanted = (
        20.0 + rng.uniform(0.05, 0.25) * outside + rng.uniform(0.3, 2.5) * shift - rng.uniform(0.0, 2.0) * (1 - working)
    )
    air = _follow(wanted, rng.uniform(1.0, 3.0)) + _fronts(rng, len(hours), 0.15, 0.1)
    column = _follow(air, rng.uniform(2.5, 8.0))
    bed = _follow(0.7 * air + 0.3 * 20.0, rng.uniform(10.0, 40.0))  # stands on ground that keeps 20 °C
    load = shift * _fronts(rng, len(hours), 0.3, 0.5, mean=1.0)
    ram = _follow(air + rng.uniform(0.5, 4.0) * load, rng.uniform(1.5, 5.0))
    head = _follow(air + rng.uniform(2.0, 8.0) * load, rng.uniform(1.0, 4.0))
    kept = slice(settling * _HOURS_A_DAY, None)
    return HallClimate(np.column_stack([column, ram, bed, air])[kept], head[kept])


def _follow(source: Array, lag_h: float) -> Array:
    """Return the temperature of a body that follows `source` with a first-order lag, hour by hour."""
    share = 1.0 - np.exp(-1.0 / lag_h)
    found = np.empty_like(source)
    state = source[0]
    for hour, value in enumerate(source):
        state += share * (value - state)
        found[hour] = state
    return found


def _fronts(rng: np.random.Generator, count: int, size: float, lag_days: float, mean: float = 0.0) -> Array:
    """Return a fluctuation with this standard deviation that forgets itself in so many days."""
    keep = np.exp(-1.0 / (lag_days * _HOURS_A_DAY))
    steps = np.sqrt(1.0 - keep**2) * size * rng.standard_normal(count)
    found = np.empty(count)
    state = size * rng.standard_normal()
    for hour in range(count):
        state = keep * state + steps[hour]
        found[hour] = mean + state
    return found
