"""Parameters of the probing of a ball: distances, feeds, the qualified stylus, and the limits that a measured ball must
keep."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from twin.arrays import Array
from twin.artefact.placement_tolerance import MOUNT_ALLOWANCE_MM
from twin.artefact.pretravel import PretravelMap
from twin.artefact.touch_pattern import (
    LOCATING_RINGS,
    RADIUS_PATTERN,
    approach_directions,
    centre_shift_per_radius,
    determines_radius,
    redundancies,
    ring_directions,
)


@dataclass(frozen=True)
class Search:
    """Search distances of a touch.

    `approach_mm` is the distance in front of the expected surface at which the touch begins. `beyond_mm` is the
    distance behind the expected surface at which a miss is declared. `guarded_feed_mm_per_s` is the feed of the moves
    beside a ball whose location is not known yet. It is None if the location is known; these moves are then made at
    rapid traverse.
    """

    approach_mm: float
    beyond_mm: float
    guarded_feed_mm_per_s: float | None = None


@dataclass(frozen=True)
class BallLimits:
    """Limits that a measured ball must keep. If a limit is exceeded, first the touches that may have caused this are
    repeated, then all touches of the ball.

    `radius_limit_mm` is the limit of the deviation from the expected radius. `form_limit_mm` is the limit of the form
    error. `touch_limit_mm` is the limit of each residual of the fitted sphere. `pole_limit_mm` is the limit of the
    distance of the touch at the pole from the sphere through the other touches. The
    names are those of the settings, in mm.
    """

    radius_limit_mm: float
    form_limit_mm: float
    touch_limit_mm: float
    pole_limit_mm: float


@dataclass(frozen=True)
class FastTouch:
    """Fast touch that locates the surface before the measuring touch. After the fast touch, the tip moves back by
    `back_off_mm` from the position latched when the probe tripped."""

    feed_mm_per_s: float
    back_off_mm: float


@dataclass(frozen=True, eq=False)
class Stylus:
    """Stylus that has been qualified by touches of a ball.

    `radius_mm` is the effective sum of the radii of ball and tip; it is smaller than the nominal sum by the pretravel.
    `radius_sigma_mm` is the standard uncertainty of the effective sum for any single ball. `fixed` is True if spheres
    are fitted with this radius. `pretravel` is the correction that is applied to every touch; it is None if touches are
    not corrected.
    """

    radius_mm: float
    radius_sigma_mm: float
    fixed: bool
    pretravel: PretravelMap | None = None


@dataclass(frozen=True)
class ProbingParameters:
    """Parameters of the probing of all balls in a run.

    `directions` (k, 3) holds the k unit vectors along which the tip moves towards the ball; the first of them points to
    the pole, which faces the stylus. All balls are touched along these vectors. Pretravel and its dependence on the
    direction (lobing) therefore shift all centres equally and cancel in their differences. At contact, the centres of
    ball and tip are `ball_radius_mm` + `tip_radius_mm` apart. `feed_mm_per_s` is the feed of the measuring touch.
    `fast_touch` is a fast touch before the measuring touch, or None. `guarded_feed_mm_per_s` is the feed of moves near
    a ball that is being located.

    `narrow_search` holds the search distances for a ball whose location is well known, and `wide_search` longer ones. A
    ball found farther than `recentre_mm` from its expected centre is measured again. `repeats` is the largest number of
    repeated measurements of a ball. `touch_sigma_mm` is the standard uncertainty of a touch.
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
        """Search distances and feed for the first ball of an artefact that has not been located yet. At this feed, the
        tip stops within the overtravel that the probe permits after its trip."""
        return replace(self.wide_search, guarded_feed_mm_per_s=self.guarded_feed_mm_per_s)

    @property
    def fastest_mm_per_s(self) -> float:
        """Highest feed at which a located ball is touched."""
        return self.feed_mm_per_s if self.fast_touch is None else max(self.fast_touch.feed_mm_per_s, self.feed_mm_per_s)

    @cached_property
    def locating_directions(self) -> Array:
        """Touch directions (5, 3) for locating a ball: one towards the pole and a ring of directions near it. They keep
        a tip that is some millimetres off its path clear of the ball's holder."""
        return ring_directions(LOCATING_RINGS, self.stylus_axis)

    @property
    def contact_mm(self) -> float:
        return self.ball_radius_mm + self.tip_radius_mm

    @property
    def expected_radius_mm(self) -> float:
        """Expected radius of a sphere through the positions latched when the probe trips. It is the qualified radius if
        the stylus has been qualified, and otherwise the sum of the nominal radii of ball and tip."""
        return self.contact_mm if self.stylus is None else self.stylus.radius_mm

    @property
    def required_travel_mm(self) -> tuple[Array, Array]:
        """Travel of X, Y and Z in mm that a touch with the distances of `wide_search` needs, as two arrays (3,): the
        travel below and the travel above the axis positions of the ball centre."""
        starts = -self.directions * (self.contact_mm + self.wide_search.approach_mm)
        below = np.maximum(0.0, -starts.min(axis=0)) + MOUNT_ALLOWANCE_MM
        return below, np.maximum(0.0, starts.max(axis=0)) + MOUNT_ALLOWANCE_MM

    @property
    def determines_radius(self) -> bool:
        """True if the touches of a ball determine its radius. If not, balls are measured with the qualified radius, and
        the touches of a position are checked against each other."""
        return determines_radius(self.directions)

    def determining_radius(self) -> ProbingParameters:
        """Return these parameters with a touch pattern that determines the radius of a ball, for the checks before the
        stylus has been qualified."""
        if self.determines_radius:
            return self
        return replace(self, directions=approach_directions(RADIUS_PATTERN, self.stylus_axis))

    @cached_property
    def redundancies(self) -> Array:
        """Redundancies (k,) of the k touches of a ball. The redundancy of a touch is the fraction of its error that
        appears in its residual (see `twin.artefact.touch_pattern`)."""
        return redundancies(self.directions)

    @cached_property
    def centre_per_radius(self) -> Array:
        """Shift (3,) of the centre of a sphere that is fitted with a fixed radius, for each millimetre by which this
        radius is too large."""
        return centre_shift_per_radius(self.directions)

    def qualified(self, stylus: Stylus) -> ProbingParameters:
        """Return a copy of these parameters that contains the qualified stylus."""
        return replace(self, stylus=stylus)
