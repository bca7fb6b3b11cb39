"""What measuring costs: machine minutes of every position, and of carrying the mount from station to station."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from twin.arrays import Array
from twin.design.candidates import Indices
from twin.errors import DataError


@dataclass(frozen=True, eq=False)
class MeasuringCosts:
    """`minutes` (N,) of measuring each candidate where the mount stands already; `stations` (N,) where each is;
    `carry_minutes` of bringing the mount to another station; `standing_at`: where it stands before, None for nowhere.

    A set is measured station by station, so each station but that costs one carry.
    """

    minutes: Array
    stations: Indices
    carry_minutes: float = 0.0
    standing_at: int | None = None

    def __post_init__(self) -> None:
        if len(self.minutes) != len(self.stations):
            raise DataError(f"{len(self.minutes)} prices for {len(self.stations)} candidates")
        if not ((self.minutes > 0.0).all() and self.carry_minutes >= 0.0):
            raise DataError("a position costs time, and carrying costs none or some")

    def total(self, chosen: Sequence[int]) -> float:
        """Minutes of a whole set."""
        carries = {int(self.stations[index]) for index in chosen} - {self.standing_at}
        return float(self.minutes[list(chosen)].sum()) + self.carry_minutes * len(carries)

    def marginal(self, chosen: Sequence[int]) -> Array:
        """(N,) minutes that each candidate costs beside the chosen ones."""
        here = [*{int(self.stations[index]) for index in chosen}, self.standing_at or 0]
        return np.asarray(self.minutes + self.carry_minutes * ~np.isin(self.stations, here))

    def cheapest_pairs(self) -> Array:
        """(N,) minutes of each candidate with the partner that is cheapest beside it."""
        cheapest = np.empty(len(self.minutes))
        for index in range(len(cheapest)):
            beside = self.marginal([index])
            beside[index] = np.inf
            cheapest[index] = self.total([index]) + beside.min()
        return cheapest
