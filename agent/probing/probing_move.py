"""Probing move through space in which an obstacle may stand, such as an artefact that nobody has located."""

from __future__ import annotations

import numpy as np

from agent.execution.steps import MoveTo, Plan, ReadPosition, TouchTowards
from agent.probing.touch import point
from drivers.roles import Touch
from twin.arrays import Array

AT_TARGET_MM = 0.01
"""A target nearer than this is not moved to; a touch without a path is refused by controllers."""


def met_on_the_way(key: str, target: Array, feed_mm_per_s: float) -> Plan[bool]:
    """Move to the axis positions `target` (3,) at the feed of a search, at which the tip stops within the overtravel of
    the probe. If the tip meets something, move back the way it came and return True."""
    start = np.array((yield ReadPosition(f"{key}/from")))
    if np.abs(target - start).max() <= AT_TARGET_MM:
        return False
    result = yield TouchTowards(key, point(target), feed_mm_per_s)
    if not isinstance(result, Touch):
        return False
    yield MoveTo(f"{key}/back", point(start), feed_mm_per_s)
    return True
