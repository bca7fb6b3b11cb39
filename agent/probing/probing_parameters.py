"""Parameters of probing a ball: distances, feeds, the qualified stylus, and the limits of a measured ball."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from twin.arrays import Array
from twin.artefact.pretravel import PretravelMap
from twin.artefact.touch_pattern import LOCATING_RINGS, centre_shift_per_radius, redundancies, ring_directions

PLACEMENT_ALLOWANCE_MM = 3.0
"""Deviation of a mount from its location that is allowed for at the ends of travel."""


@dataclass(frozen=True)
class Search:
    """Distance before the expected surface at which the slow feed begins, and beyond it at which a miss is declared.

    `guarded_feed_mm_per_s`: feed of the moves beside a ball that must be located first; None: rapid, beside a ball
    whose location is known.
    """

    approach_mm: float
    beyond_mm: float
    guarded_feed_mm_per_s: float | None = None


@dataclass(frozen=True)
class BallLimits:
    """Limits of a measured ball; if one is exceeded, touches and then the ball are repeated, then the policy applies.

    `touch_mm`: limit of a residual of the fitted sphere; `pole_mm`: limit of the pole's distance from the sphere
    through the other touches.
    """

    radius_deviation_mm: float
    form_mm: float
    touch_mm: float
    pole_mm: float


@dataclass(frozen=True)
class FastTouch:
    """First of two touches: fast, to locate the surface; then back by `back_off_mm` from the latched position."""

    feed_mm_per_s: float
    back_off_mm: float


@dataclass(frozen=True, eq=False)
class Stylus:
    """Qualified stylus. `radius_mm`: effective radius of ball and tip together (reduced by the pretravel).

    `radius_sigma_mm`: its standard uncertainty for any single ball; `fixed`: spheres are fitted with this radius;
    `pretravel`: correction of every touch.
    """

    radius_mm: float
    radius_sigma_mm: float
    fixed: bool
    pretravel: PretravelMap | None = None


@dataclass(frozen=True)
class ProbingParameters:
    """Parameters of probing. `directions` (k, 3): unit vectors of the tip's travel towards the ball, the pole first.

    The same vectors on every ball keep pretravel and lobing common to all, so that they cancel in
    differences. `ball_radius_mm` + `tip_radius_mm` is the distance of the centres at contact. `feed_mm_per_s` is that
    of the measuring touch; `fast_touch`: None if the first touch is the measuring one; `guarded_feed_mm_per_s`: feed of
    moves near a ball that is being located.
    """

    directions: Array
    stylus_axis: Array
    ball_radius_mm: float
    tip_radius_mm: float
    narrow_search: Search
    wide_search: Search
    feed_mm_per_s: float
    retract_mm: float
    touch_sigma_mm: float
    limits: BallLimits
    recentre_mm: float
    repeats: int
    stop_on_failure: bool
    fast_touch: FastTouch | None = None
    stylus: Stylus | None = None
    guarded_feed_mm_per_s: float | None = None

    @property
    def locating_search(self) -> Search:
        """Search for the first ball of an artefact not located yet: slow enough to stop within the overtravel."""
        return replace(self.wide_search, guarded_feed_mm_per_s=self.guarded_feed_mm_per_s)

    @property
    def fastest_mm_per_s(self) -> float:
        """Highest feed at which a located ball is touched."""
        return self.feed_mm_per_s if self.fast_touch is None else max(self.fast_touch.feed_mm_per_s, self.feed_mm_per_s)

    @cached_property
    def locating_directions(self) -> Array:
        """Directions (5, 3): the pole and a ring before it, where a tip some mm off stays clear of the holder."""
        return ring_directions(LOCATING_RINGS, self.stylus_axis)

    @property
    def contact_mm(self) -> float:
        return self.ball_radius_mm + self.tip_radius_mm

    @property
    def expected_radius_mm(self) -> float:
        """Expected radius of a sphere through latched positions: qualified, or by the drawings."""
        return self.contact_mm if self.stylus is None else self.stylus.radius_mm

    @property
    def required_travel_mm(self) -> tuple[Array, Array]:
        """Travel (3,) needed below and above a ball's axis position to touch it with the wide search."""
        starts = -self.directions * (self.contact_mm + self.wide_search.approach_mm)
        below = np.maximum(0.0, -starts.min(axis=0)) + PLACEMENT_ALLOWANCE_MM
        return below, np.maximum(0.0, starts.max(axis=0)) + PLACEMENT_ALLOWANCE_MM

    @cached_property
    def redundancies(self) -> Array:
        """Redundancies (k,): part of a touch's error that shows in its residual (`twin.artefact.touch_pattern`)."""
        return redundancies(self.directions)

    @cached_property
    def centre_per_radius(self) -> Array:
        """Shift (3,) of a fitted centre for each mm by which a fixed radius is too large."""
        return centre_shift_per_radius(self.directions)

    def qualified(self, stylus: Stylus) -> ProbingParameters:
        """Return these parameters with the qualified `stylus`."""
        return replace(self, stylus=stylus)
