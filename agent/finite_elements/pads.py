"""Pads on a face of a part, and the points at which they are integrated."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from twin.arrays import Array

_ALONG_POINTS, _ACROSS_POINTS = 8, 3
"""Gauss points of a patch: cos² times two parabolas along the pad, two parabolas across it (exact)."""
_THINNEST = 1e-9


@dataclass(frozen=True)
class PadPoints:
    """Quadrature points of one pad on k rectangles, each the part of the pad on one facet of the mesh.

    `facets` (k,) are the rows of the facets, `places` (3, k, p) the points in mm, and `measure` (k, p) their weights in
    mm², with the pressure of the pad in them: the sum is the `area` of the pad.
    """

    facets: NDArray[np.intp]
    places: Array
    measure: Array

    @property
    def area(self) -> float:
        return float(self.measure.sum())

    @classmethod
    def joined(cls, pads: Sequence[PadPoints]) -> PadPoints:
        """Return the points of several pads together."""
        return cls(
            np.concatenate([pad.facets for pad in pads]),
            np.concatenate([pad.places for pad in pads], axis=1),
            np.concatenate([pad.measure for pad in pads]),
        )


@dataclass(frozen=True)
class Pads:
    """Strips on a face of a part that carry or load it.

    The face is normal to `axis` at the coordinate `at_mm`. Along `along`, each pad reaches `length_mm` over its centre
    in `centres_mm`, with a pressure that falls to zero at its ends (cos²); None for the whole face. `walls_of_mm` keeps
    the pads over the walls: only points further than it from the middle of the third direction count.
    """

    axis: int
    at_mm: float
    along: int | None = None
    centres_mm: tuple[float, ...] = ()
    length_mm: float = 0.0
    walls_of_mm: float = 0.0

    def points(self, low: Array, high: Array) -> tuple[PadPoints, ...]:
        """Return the quadrature points of each pad on the rectangular facets between the corners `low` and `high`
        (n, 3) in mm. No rectangle reaches over the border of a pad, so the pressure is smooth on each."""
        first, second = (axis for axis in range(3) if axis != self.axis)
        if self.along is None:
            return (self._on(low, high, (first, -np.inf, np.inf), (second, -np.inf, np.inf)),)
        across, half = 3 - self.axis - self.along, 0.5 * self.length_mm
        strips = [(-np.inf, -self.walls_of_mm), (self.walls_of_mm, np.inf)]
        return tuple(
            PadPoints.joined(
                [
                    self._on(low, high, (self.along, centre - half, centre + half), (across, *strip), centre)
                    for strip in strips
                ]
            )
            for centre in self.centres_mm
        )

    def stated_area(self, low: Array, high: Array) -> float | None:
        """Return the area in mm² of one pad that lies on the face as a whole, with its pressure as weight: L/2 times
        the width of the walls. None for the whole face. `low` and `high` (n, 3) are those of `points`."""
        if self.along is None:
            return None
        across = 3 - self.axis - self.along
        width = max(high[:, across].max() - self.walls_of_mm, 0.0) + max(-self.walls_of_mm - low[:, across].min(), 0.0)
        return float(0.5 * self.length_mm * width)

    def _on(
        self,
        low: Array,
        high: Array,
        along: tuple[int, float, float],
        across: tuple[int, float, float],
        centre: float | None = None,
    ) -> PadPoints:
        """Return the points on the facets between the bounds (axis, lower, upper) along and across a pad."""
        ends = [
            (np.maximum(low[:, axis], start), np.minimum(high[:, axis], end)) for axis, start, end in (along, across)
        ]
        touched = np.flatnonzero(np.logical_and(*(end - start > _THINNEST for start, end in ends)))
        (u, du), (v, dv) = (
            _gauss(start[touched], end[touched], count)
            for (start, end), count in zip(ends, (_ALONG_POINTS, _ACROSS_POINTS), strict=True)
        )
        pressure = np.ones_like(u) if centre is None else np.cos(np.pi * (u - centre) / self.length_mm) ** 2
        shape = (touched.size, _ALONG_POINTS * _ACROSS_POINTS)
        places = np.full((3, *shape), self.at_mm)
        places[along[0]] = np.repeat(u, _ACROSS_POINTS, axis=1)
        places[across[0]] = np.tile(v, (1, _ALONG_POINTS))
        measure = (pressure * du)[:, :, None] * dv[:, None, :]
        return PadPoints(touched, places, measure.reshape(shape))


def _gauss(start: Array, end: Array, count: int) -> tuple[Array, Array]:
    """Return the Gauss points (k, count) and weights (k, count) of the intervals from `start` to `end` (k,)."""
    points, weights = np.polynomial.legendre.leggauss(count)
    half = 0.5 * (end - start)[:, None]
    return 0.5 * (start + end)[:, None] + half * points, half * weights
