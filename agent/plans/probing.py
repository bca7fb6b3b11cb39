"""How a ball is touched: distances, feeds and the limits a measured ball must keep."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Vectors = NDArray[np.float64]

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
