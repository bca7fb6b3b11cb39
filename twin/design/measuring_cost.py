"""Cost of measuring in machine minutes: the time for each position of the artefact, and for moving its mount between
stations."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from twin.arrays import Array
from twin.design.candidates import Indices
from twin.errors import DataError


@dataclass(frozen=True, eq=False)
class MeasuringCosts:
    """Measuring time of N candidate positions of an artefact that is held by a mount.

    `minutes` (N,) is the time to measure each candidate if the mount is already at the station (place) of the
    candidate. `stations` (N,) is this station of each candidate. `carry_minutes` is the time to move the mount to
    another station. `standing_at` is the initial station of the mount, or None if the mount is at no station.

    A position set is measured station by station. The mount is therefore moved once for each station of the set, except
    for the initial station.

    A run also takes time that does not depend on the set: `fixed_minutes`, which includes the moves of the mount to the
    stations `visited_anyway`. These stations cost no move of their own if positions of the set are measured there.
    """

    minutes: Array
    stations: Indices
    carry_minutes: float = 0.0
    standing_at: int | None = None
    fixed_minutes: float = 0.0
    visited_anyway: frozenset[int] = frozenset()

    def __post_init__(self) -> None:
        if len(self.minutes) != len(self.stations):
            raise DataError(f"{len(self.minutes)} measuring times for {len(self.stations)} candidates")
        if not ((self.minutes > 0.0).all() and min(self.carry_minutes, self.fixed_minutes) >= 0.0):
            raise DataError("measuring times must be positive, and other times must not be negative")

    def total(self, chosen: Sequence[int]) -> float:
        """Return the minutes of a run that measures the candidates with the indices `chosen`, including the moves of
        the mount between stations."""
        carries = {int(self.stations[index]) for index in chosen} - {self.standing_at, *self.visited_anyway}
        return float(self.minutes[list(chosen)].sum()) + self.carry_minutes * len(carries) + self.fixed_minutes

    def marginal(self, chosen: Sequence[int]) -> Array:
        """Return the additional minutes (N,) that each candidate would take if it were added to the candidates
        `chosen`."""
        # stations count from 1, so 0 stands for a mount that is at none
        here = [*{int(self.stations[index]) for index in chosen}, *self.visited_anyway, self.standing_at or 0]
        return np.asarray(self.minutes + self.carry_minutes * ~np.isin(self.stations, here))

    def cheapest_pairs(self) -> Array:
        """Return, for each candidate, the shortest time (N,) in minutes of a run that measures the candidate and one
        other candidate."""
        cheapest = np.empty(len(self.minutes))
        for index in range(len(cheapest)):
            beside = self.marginal([index])
            beside[index] = np.inf
            cheapest[index] = self.total([index]) + beside.min()
        return cheapest
