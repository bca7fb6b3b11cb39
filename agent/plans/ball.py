"""One ball: touches by the pattern, a sphere through the latched positions, limits, bounded repeats."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from agent.execution.steps import MoveTo, Plan, Point, Record, TouchTowards
from agent.plans.probing import Probing, Search
from drivers.errors import MeasurementFault
from drivers.roles import Touch
from twin.errors import TwinError
from twin.sphere import SphereFit, fit_sphere

Vector = NDArray[np.float64]


@dataclass(frozen=True)
class BallFound:
    """`centre_mm` (3,): axis positions, as displayed, at which stylus centre and ball centre coincide."""

    centre_mm: Vector
    covariance_mm2: NDArray[np.float64]
    radius_mm: float
    form_mm: float
    touches: int


@dataclass(frozen=True)
class BallLost:
    """Not measured, and why."""

    reason: str
    touches: int


def measure_ball(key: str, predicted_mm: Vector, probing: Probing, search: Search) -> Plan[BallFound | BallLost]:
    """Touch the ball where it is expected; repeat where a limit is broken; decide by policy.

    A touch that misses widens the search once. A centre that is found far from where it was expected is
    measured again from there, so that every ball is approached along the same normals.
    """
    centre, attempt_search, touches = predicted_mm, search, 0
    reason = ""
    for attempt in range(1 + probing.repeats):
        attempt_key = key if attempt == 0 else f"{key}/repeat-{attempt}"
        fit = yield from _touch_all(attempt_key, centre, probing, attempt_search)
        touches += len(probing.directions)
        if isinstance(fit, str):
            reason, attempt_search = fit, probing.wide
        else:
            away = float(np.linalg.norm(fit.centre - centre))
            centre, attempt_search = fit.centre, probing.narrow
            reason = _broken_limit(fit, probing)
            if not reason and away <= probing.recentre_mm:
                return BallFound(fit.centre, fit.covariance[:3, :3], fit.radius, fit.form, touches)
            reason = reason or f"found {away:.3f} mm from where it was expected, {attempt + 1} times"
        yield Record(f"{attempt_key}/again", "event", {"reason": reason})
    if probing.stop_on_failure:
        raise MeasurementFault(
            f"the ball could not be measured: {reason}",
            hint="clean the ball and the stylus, check that both are tight and where the artefact stands",
            step=key,
        )
    return BallLost(reason, touches)


def _touch_all(key: str, centre: Vector, probing: Probing, search: Search) -> Plan[SphereFit | str]:
    """Touch in every direction; the fitted sphere, or the reason why there is none."""
    reach = probing.contact_mm + search.approach_mm
    latched: list[Point] = []
    for number, direction in enumerate(probing.directions):
        touch_key = f"{key}/touch-{number}"
        start = centre - direction * reach
        above = start - probing.stylus_axis * (reach + float((start - centre) @ probing.stylus_axis))
        beside_pole = number > 0
        yield MoveTo(f"{touch_key}/above", point(above))
        if beside_pole:
            yield MoveTo(f"{touch_key}/start", point(start))
        target = centre - direction * (probing.contact_mm - search.beyond_mm)
        result = yield TouchTowards(touch_key, point(target), probing.feed_mm_per_s)
        yield MoveTo(f"{touch_key}/back", point(above))
        if not isinstance(result, Touch):
            return f"touch {number} met nothing"
        latched.append(result.position_mm)
    try:
        return fit_sphere(np.array(latched), probing.touch_sigma_mm, None)
    except TwinError as error:
        return f"no sphere through the touches: {error}"


def _broken_limit(fit: SphereFit, probing: Probing) -> str:
    deviation = fit.radius - probing.contact_mm
    limits = probing.limits
    if abs(deviation) > limits.radius_deviation_mm:
        return f"radius is off by {deviation * 1e3:.1f} µm, allowed {limits.radius_deviation_mm * 1e3:.1f} µm"
    if fit.form > limits.form_mm:
        return f"form is {fit.form * 1e3:.1f} µm, allowed {limits.form_mm * 1e3:.1f} µm"
    return ""


def point(vector: Vector) -> Point:
    """A plain tuple for a step."""
    x, y, z = vector.tolist()
    return x, y, z
