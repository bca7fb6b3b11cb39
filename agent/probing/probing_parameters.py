"""How a ball is touched: distances, feeds, what is known of the stylus, and the limits a measured ball must keep."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from twin.arrays import Array
from twin.artefact.pretravel import PretravelMap
from twin.artefact.touch_pattern import LOCATING_RINGS, centre_shift_per_radius, redundancies, ring_directions

PLACEMENT_ALLOWANCE_MM = 3.0
"""By so much a mount may stand off its place before a ball near the end of travel is out of reach after all."""


@dataclass(frozen=True)
class Search:
    """Where the slow feed begins before the expected surface, and how far beyond it a miss is declared.

    `beside_mm_per_s`: feed of the moves beside the ball where it has to be looked for first; None: rapid, where its
    place is known.
    """

    approach_mm: float
    beyond_mm: float
    beside_mm_per_s: float | None = None


@dataclass(frozen=True)
class BallLimits:
    """A measured ball outside any of these is cleaned up, repeated, then handled by policy.

    `touch_mm`: of a residual of the fitted sphere; `pole_mm`: of the pole's distance from the sphere through the rest.
    """

    radius_deviation_mm: float
    form_mm: float
    touch_mm: float
    pole_mm: float


@dataclass(frozen=True)
class FastTouch:
    """The first of two touches: fast, to know where the surface is; then back by `back_off_mm` from what it latched."""

    feed_mm_per_s: float
    back_off_mm: float


@dataclass(frozen=True, eq=False)
class Stylus:
    """What the qualification found. `radius_mm`: of ball and tip together, as the probe sees it (pretravel taken off).

    `radius_sigma_mm`: standard uncertainty of that for any one ball; `fixed`: whether spheres are fitted with it;
    `pretravel`: applied to every touch.
    """

    radius_mm: float
    radius_sigma_mm: float
    fixed: bool
    pretravel: PretravelMap | None = None


@dataclass(frozen=True)
class ProbingParameters:
    """`directions` (k, 3): unit vectors in which the tip travels towards the ball, the pole first.

    The same vectors on every ball keep pretravel and lobing common to all, so that they cancel in
    differences. `ball_radius_mm` + `tip_radius_mm` is the distance of the centres at contact. `feed_mm_per_s` is that
    of the touch that counts; `find`: None where the first touch counts; `careful_mm_per_s`: of moves near a ball that
    is looked for.
    """

    directions: Array
    stylus_axis: Array
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
    find: FastTouch | None = None
    stylus: Stylus | None = None
    careful_mm_per_s: float | None = None

    @property
    def unknown(self) -> Search:
        """For the first ball of an artefact that nobody has found yet: slow enough to stop within the overtravel."""
        return replace(self.wide, beside_mm_per_s=self.careful_mm_per_s)

    @property
    def fastest_mm_per_s(self) -> float:
        """At which a ball that has been located is met."""
        return self.feed_mm_per_s if self.find is None else max(self.find.feed_mm_per_s, self.feed_mm_per_s)

    @cached_property
    def locating(self) -> Array:
        """(5, 3): the pole and a ring before the ball, where no holder is in the way of a tip that is some mm off."""
        return ring_directions(LOCATING_RINGS, self.stylus_axis)

    @property
    def contact_mm(self) -> float:
        return self.ball_radius_mm + self.tip_radius_mm

    @property
    def expected_radius_mm(self) -> float:
        """Of a sphere through latched positions: qualified, or by the drawings."""
        return self.contact_mm if self.stylus is None else self.stylus.radius_mm

    @property
    def room_mm(self) -> tuple[Array, Array]:
        """Travel (3,) that touching with the wide search needs below and above a ball's axis position."""
        starts = -self.directions * (self.contact_mm + self.wide.approach_mm)
        below = np.maximum(0.0, -starts.min(axis=0)) + PLACEMENT_ALLOWANCE_MM
        return below, np.maximum(0.0, starts.max(axis=0)) + PLACEMENT_ALLOWANCE_MM

    @cached_property
    def redundancies(self) -> Array:
        """(k,): the part of a touch's own error that its residual shows; see `twin.artefact.touch_pattern`."""
        return redundancies(self.directions)

    @cached_property
    def centre_per_radius(self) -> Array:
        """(3,): motion of a fitted centre for each mm by which a fixed radius is too large."""
        return centre_shift_per_radius(self.directions)

    def qualified(self, stylus: Stylus) -> ProbingParameters:
        """The same with what is known of the stylus now."""
        return replace(self, stylus=stylus)
