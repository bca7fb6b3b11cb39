"""One touch on a ball: in beside it, to the surface, back out. Only what the controller latched at the trip counts."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from agent.execution.steps import MoveTo, Plan, Point, TouchTowards
from agent.plans.probing import Probing, Search
from drivers.roles import Touch

Vector = NDArray[np.float64]


@dataclass(frozen=True)
class Touched:
    """`latched_mm`: None for a miss. `trips`: touches that it took, the fast one included."""

    latched_mm: Point | None
    trips: int


def touch_ball(key: str, centre: Vector, direction: Vector, probing: Probing, search: Search) -> Plan[Touched]:
    """Touch the ball at `centre` along `direction`; begins and ends in the plane before the ball, along the stylus."""
    reach = probing.contact_mm + search.approach_mm
    start = centre - direction * reach
    above = start - probing.stylus_axis * (reach + float((start - centre) @ probing.stylus_axis))
    yield MoveTo(f"{key}/above", point(above))
    if np.abs(start - above).max() > 0.0:
        yield MoveTo(f"{key}/start", point(start))
    target = centre - direction * (probing.contact_mm - search.beyond_mm)
    touched = yield from _trip(key, target, direction, probing)
    yield MoveTo(f"{key}/back", point(above))
    return touched


def _trip(key: str, target: Vector, direction: Vector, probing: Probing) -> Plan[Touched]:
    """One touch at the measuring feed, or a fast one that finds and a slow one that measures."""
    find = probing.find
    if find is None:
        result = yield TouchTowards(key, point(target), probing.feed_mm_per_s)
        return Touched(result.position_mm if isinstance(result, Touch) else None, 1)
    found = yield TouchTowards(f"{key}/find", point(target), find.feed_mm_per_s)
    if not isinstance(found, Touch):
        return Touched(None, 1)
    surface = np.array(found.position_mm)
    yield MoveTo(f"{key}/back-off", point(surface - direction * find.back_off_mm))
    beyond = surface + direction * find.back_off_mm
    result = yield TouchTowards(key, point(beyond), probing.feed_mm_per_s)
    return Touched(result.position_mm if isinstance(result, Touch) else None, 2)


def point(vector: Vector) -> Point:
    """A plain tuple for a step."""
    x, y, z = vector.tolist()
    return x, y, z
