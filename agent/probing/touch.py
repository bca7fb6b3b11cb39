"""One touch of a ball. The tip approaches the ball, touches its surface and retracts. Only the position latched at the
trip is used."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np

from agent.execution.steps import MoveTo, Plan, Point, TouchTowards
from agent.probing.probing_parameters import ProbingParameters, Search
from drivers.roles import Touch, Vector

SAME_POSITION_MM = 1e-6
"""Distance in mm below which two axis positions are the same; no controller resolves it."""


@dataclass(frozen=True)
class TouchResult:
    """Result of a touch. `latched_mm` holds the axis positions at the trip; it is None if the probe did not trip.
    `touches` is the number of touches made, including a preceding fast touch."""

    latched_mm: Point | None
    touches: int


@dataclass(frozen=True, eq=False)
class PlannedTouch:
    """Touch that is to be made along the unit vector `direction`, on a ball expected at the axis positions `centre`
    (3,). `contact_mm` is the distance between the centres of ball and tip at contact."""

    centre: Vector
    direction: Vector
    search: Search
    contact_mm: float

    @property
    def out_mm(self) -> float:
        return self.contact_mm + self.search.approach_mm

    @cached_property
    def start(self) -> Vector:
        return np.asarray(self.centre - self.direction * self.out_mm)

    @property
    def surface(self) -> Vector:
        """Axis positions (3,) at which the probe is expected to trip."""
        return np.asarray(self.centre - self.direction * self.contact_mm)


class TouchPath(Protocol):
    """Interface of a path that leads the tip to the start of a touch, and away from the surface after the touch."""

    def approach(self, key: str, touch: PlannedTouch) -> Plan[None]: ...

    def retract(self, key: str, touch: PlannedTouch, latched_mm: Point | None) -> Plan[None]: ...


@dataclass(frozen=True, eq=False)
class PlainTouchPath:
    """Path along the stylus from a plane in front of the ball, perpendicular to the stylus, to the start of a touch,
    and back to that plane. The path is free of collisions if the ball is accessible. From a ball whose location is not
    known, the path leads back as it came."""

    probing: ProbingParameters

    def approach(self, key: str, touch: PlannedTouch) -> Plan[None]:
        start, above = touch.start, before_ball(touch, self.probing)
        feed = touch.search.guarded_feed_mm_per_s
        yield MoveTo(f"{key}/above", point(above), feed)
        # A touch along the stylus starts in the plane itself, but for the rounding of the two positions.
        if np.abs(start - above).max() > SAME_POSITION_MM:
            yield MoveTo(f"{key}/start", point(start), feed)

    def retract(self, key: str, touch: PlannedTouch, latched_mm: Point | None) -> Plan[None]:
        start, before = touch.start, before_ball(touch, self.probing)
        feed = touch.search.guarded_feed_mm_per_s
        if feed is not None and np.abs(start - before).max() > SAME_POSITION_MM:
            # A ball whose location is not known may bulge between the contact and the plane. The tip first returns on
            # the line on which it came, at rapid traverse: the probe is still deflected and cannot guard this move.
            yield MoveTo(f"{key}/off", point(start))
            yield MoveTo(f"{key}/back", point(before), feed)
        else:
            yield MoveTo(f"{key}/back", point(before))


def before_ball(touch: PlannedTouch, probing: ProbingParameters) -> Vector:
    """Return axis positions (3,) in front of the ball, in a plane perpendicular to the stylus. From there, the tip
    reaches the start of `touch` by a straight move along the stylus."""
    along = touch.out_mm + float((touch.start - touch.centre) @ probing.stylus_axis)
    return np.asarray(touch.start - probing.stylus_axis * along)


def touch_ball(
    key: str,
    centre: Vector,
    direction: Vector,
    probing: ProbingParameters,
    search: Search,
    path: TouchPath | None = None,
) -> Plan[TouchResult]:
    """Touch the ball at `centre` along `direction`. `path` leads the tip to the start of the touch and away from the
    surface. If `path` is None, the tip moves along the stylus from and to a plane in front of the ball."""
    touch = PlannedTouch(centre, direction, search, probing.contact_mm)
    chosen = path or PlainTouchPath(probing)
    yield from chosen.approach(key, touch)
    target = centre - direction * (probing.contact_mm - search.beyond_mm)
    touched = yield from _trip(key, target, direction, probing)
    yield from chosen.retract(key, touch, touched.latched_mm)
    return touched


def _trip(key: str, target: Vector, direction: Vector, probing: ProbingParameters) -> Plan[TouchResult]:
    """Touch at the measuring feed, after a fast touch that locates the surface if `probing.fast_touch` is set."""
    fast_touch = probing.fast_touch
    if fast_touch is None:
        result = yield TouchTowards(key, point(target), probing.feed_mm_per_s)
        return TouchResult(result.position_mm if isinstance(result, Touch) else None, 1)
    found = yield TouchTowards(f"{key}/find", point(target), fast_touch.feed_mm_per_s)
    if not isinstance(found, Touch):
        return TouchResult(None, 1)
    surface = np.array(found.position_mm)
    yield MoveTo(f"{key}/back-off", point(surface - direction * fast_touch.back_off_mm))
    beyond = surface + direction * fast_touch.back_off_mm
    result = yield TouchTowards(key, point(beyond), probing.feed_mm_per_s)
    return TouchResult(result.position_mm if isinstance(result, Touch) else None, 2)


def point(vector: Vector) -> Point:
    """Return `vector` (3,) as a tuple, because the steps of a plan contain points as tuples."""
    x, y, z = vector.tolist()
    return x, y, z
