"""One touch on a ball: in beside it, to the surface, back out. Only what the controller latched at the trip counts."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np

from agent.execution.steps import MoveTo, Plan, Point, TouchTowards
from agent.probing.probing_parameters import ProbingParameters, Search
from drivers.roles import Touch, Vector


@dataclass(frozen=True)
class TouchResult:
    """`latched_mm`: None for a miss. `trips`: touches that it took, the fast one included."""

    latched_mm: Point | None
    trips: int


@dataclass(frozen=True, eq=False)
class PlannedTouch:
    """Where a touch begins: the ball thought at `centre`, touched along the unit vector `direction`."""

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
        """Where the tip should trip."""
        return np.asarray(self.centre - self.direction * self.contact_mm)


class TouchPath(Protocol):
    """How the tip gets to where a touch begins, and away from where it ended."""

    def to(self, key: str, begin: PlannedTouch) -> Plan[None]: ...

    def away(self, key: str, begin: PlannedTouch, latched_mm: Point | None) -> Plan[None]: ...


@dataclass(frozen=True, eq=False)
class PlainTouchPath:
    """From the plane before the ball, along the stylus, and back there: free wherever the ball is accessible."""

    probing: ProbingParameters

    def to(self, key: str, begin: PlannedTouch) -> Plan[None]:
        start, above = begin.start, before_ball(begin, self.probing)
        feed = begin.search.beside_mm_per_s
        yield MoveTo(f"{key}/above", point(above), feed)
        if np.abs(start - above).max() > 0.0:
            yield MoveTo(f"{key}/start", point(start), feed)

    def away(self, key: str, begin: PlannedTouch, latched_mm: Point | None) -> Plan[None]:
        yield MoveTo(f"{key}/back", point(before_ball(begin, self.probing)))


def before_ball(begin: PlannedTouch, probing: ProbingParameters) -> Vector:
    """Before where the touch begins, in the plane before the ball, as far out as any touch begins."""
    along = begin.out_mm + float((begin.start - begin.centre) @ probing.stylus_axis)
    return np.asarray(begin.start - probing.stylus_axis * along)


def touch_ball(
    key: str,
    centre: Vector,
    direction: Vector,
    probing: ProbingParameters,
    search: Search,
    way: TouchPath | None = None,
) -> Plan[TouchResult]:
    """Touch the ball at `centre` along `direction`, `way` there and back; by default by the plane before the ball."""
    begin = PlannedTouch(centre, direction, search, probing.contact_mm)
    chosen = way or PlainTouchPath(probing)
    yield from chosen.to(key, begin)
    target = centre - direction * (probing.contact_mm - search.beyond_mm)
    touched = yield from _trip(key, target, direction, probing)
    yield from chosen.away(key, begin, touched.latched_mm)
    return touched


def _trip(key: str, target: Vector, direction: Vector, probing: ProbingParameters) -> Plan[TouchResult]:
    """One touch at the measuring feed, or a fast one that finds and a slow one that measures."""
    find = probing.find
    if find is None:
        result = yield TouchTowards(key, point(target), probing.feed_mm_per_s)
        return TouchResult(result.position_mm if isinstance(result, Touch) else None, 1)
    found = yield TouchTowards(f"{key}/find", point(target), find.feed_mm_per_s)
    if not isinstance(found, Touch):
        return TouchResult(None, 1)
    surface = np.array(found.position_mm)
    yield MoveTo(f"{key}/back-off", point(surface - direction * find.back_off_mm))
    beyond = surface + direction * find.back_off_mm
    result = yield TouchTowards(key, point(beyond), probing.feed_mm_per_s)
    return TouchResult(result.position_mm if isinstance(result, Touch) else None, 2)


def point(vector: Vector) -> Point:
    """A plain tuple for a step."""
    x, y, z = vector.tolist()
    return x, y, z
