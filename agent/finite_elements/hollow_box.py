"""Hexahedral mesh of a hollow box with ribs: the shape of a bed, a column or a ram."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from twin.arrays import Array

_SAME = 1e-6


@dataclass(frozen=True)
class HollowBox:
    """Box along `axis` (0 to 2), from `low_mm` to `high_mm` (3,) in machine axes, with walls all round along its axis
    and ribs across it.

    The ribs, the first and the last at the ends, are `rib_mm` thick and at most `rib_pitch_mm` apart. `cells` is the
    number of elements between two ribs and across the hollow.
    """

    axis: int
    low_mm: tuple[float, float, float]
    high_mm: tuple[float, float, float]
    wall_mm: float
    rib_mm: float
    rib_pitch_mm: float
    cells: int = 1

    def lines(self) -> tuple[Array, Array, Array]:
        """Return the coordinates in mm of the planes between the elements along x, y and z."""
        found = [self._across(low, high) for low, high in zip(self.low_mm, self.high_mm, strict=True)]
        found[self.axis] = self._along()
        return found[0], found[1], found[2]

    def is_solid(self, centres: Array) -> Array:
        """Return True for each of the points (3, n) in mm, none of them on a surface, that is in a wall or a rib."""
        hollow = np.ones(centres.shape[1], dtype=bool)
        for axis, (low, high) in enumerate(zip(self.low_mm, self.high_mm, strict=True)):
            if axis != self.axis:
                hollow &= (centres[axis] > low + self.wall_mm) & (centres[axis] < high - self.wall_mm)
        along = centres[self.axis]
        for start in self._ribs():
            hollow &= ~((along > start) & (along < start + self.rib_mm))
        return np.asarray(~hollow)

    def _ribs(self) -> Array:
        """Return the coordinate in mm at which each rib begins."""
        low, high = self.low_mm[self.axis], self.high_mm[self.axis]
        bays = max(1, int(np.ceil((high - low - self.rib_mm) / self.rib_pitch_mm - _SAME)))
        return np.linspace(low, high - self.rib_mm, bays + 1)

    def _along(self) -> Array:
        starts = self._ribs()
        planes = [starts[:1], starts[:1] + self.rib_mm]
        for before, after in pairwise(starts):
            planes += [np.linspace(before + self.rib_mm, after, self.cells + 1)[1:], np.array([after + self.rib_mm])]
        return np.concatenate(planes)

    def _across(self, low: float, high: float) -> Array:
        inner = np.linspace(low + self.wall_mm, high - self.wall_mm, self.cells + 1)
        return np.concatenate(([low], inner, [high]))
