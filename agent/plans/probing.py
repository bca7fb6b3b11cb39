"""How a ball is touched: approach vectors, distances, feeds and the limits a measured ball must keep."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Vectors = NDArray[np.float64]

# Rings of touches beside the pole: (latitude above the equator in degrees, touches, turn about the stylus).
# The five-point ring is turned by 45° so that a holder that stands along a machine axis is passed by.
RINGS: dict[int, tuple[tuple[float, int, float], ...]] = {
    5: ((0.0, 4, 45.0),),
    9: ((45.0, 4, 0.0), (0.0, 4, 45.0)),
    13: ((60.0, 4, 0.0), (30.0, 4, 45.0), (0.0, 4, 0.0)),
    25: ((60.0, 8, 0.0), (30.0, 8, 22.5), (0.0, 8, 0.0)),
}


PLACE_ROOM_MM = 3.0
"""By so much a mount may stand off its place before a ball near the end of travel is out of reach after all."""


@dataclass(frozen=True)
class Search:
    """Where the slow feed begins before the expected surface, and how far beyond it a miss is declared."""

    approach_mm: float
    beyond_mm: float


@dataclass(frozen=True)
class BallLimits:
    """A measured ball outside any of these is repeated, then handled by policy."""

    radius_deviation_mm: float
    form_mm: float


@dataclass(frozen=True)
class Probing:
    """`directions` (k, 3): unit vectors in which the tip travels towards the ball, the pole first.

    The same vectors on every ball keep pretravel and lobing common to all, so that they cancel in
    differences. `ball_radius_mm` + `tip_radius_mm` is the distance of the centres at contact.
    """

    directions: Vectors
    stylus_axis: Vectors
    ball_radius_mm: float
    tip_radius_mm: float
    narrow: Search
    wide: Search
    feed_mm_per_s: float
    retract_mm: float
    touch_sigma_mm: float
    limits: BallLimits
    recentre_mm: float
    repeats: int
    stop_on_failure: bool

    @property
    def contact_mm(self) -> float:
        return self.ball_radius_mm + self.tip_radius_mm

    @property
    def room_mm(self) -> tuple[Vectors, Vectors]:
        """Travel (3,) that touching with the wide search needs below and above a ball's axis position."""
        starts = -self.directions * (self.contact_mm + self.wide.approach_mm)
        below = np.maximum(0.0, -starts.min(axis=0)) + PLACE_ROOM_MM
        return below, np.maximum(0.0, starts.max(axis=0)) + PLACE_ROOM_MM


def approach_directions(count: int, stylus_axis: Vectors) -> Vectors:
    """Approach vectors of the pattern with `count` touches, the pole first.

    `stylus_axis` (3,): unit vector from the ram towards the tip. Shape (count, 3).
    Raises ValueError for a pattern that is not one of 5, 9, 13, 25.
    """
    if count not in RINGS:
        raise ValueError(f"no pattern of {count} touches; there are {sorted(RINGS)}")
    pole = stylus_axis / np.linalg.norm(stylus_axis)
    first, second = _perpendiculars(pole)
    rows = [pole]
    for latitude_deg, touches, turn_deg in RINGS[count]:
        height, width = math.sin(math.radians(latitude_deg)), math.cos(math.radians(latitude_deg))
        for index in range(touches):
            angle = math.radians(turn_deg + 360.0 * index / touches)
            sideways = math.cos(angle) * first + math.sin(angle) * second
            rows.append(height * pole - width * sideways)
    return np.array(rows)


def _perpendiculars(pole: Vectors) -> tuple[Vectors, Vectors]:
    """Two unit vectors square to the pole, along machine axes where the pole is one."""
    axis = np.eye(3)[np.argmin(np.abs(pole))]
    first = axis - pole * (axis @ pole)
    first /= np.linalg.norm(first)
    return first, np.cross(first, pole)
