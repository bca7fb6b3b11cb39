"""Check of the repeatability of the probe. The pole of a ball (the point that faces the stylus) is touched n times, and
twice the standard deviation (2σ) of these touches is compared with a limit. The comparison takes the confidence
interval of 2σ into account."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from agent.errors import MeasurementFault
from agent.execution.steps import Plan, Record
from agent.probing.probing_parameters import ProbingParameters
from agent.probing.touch import touch_ball
from drivers.roles import Vector
from twin.artefact.repeatability import RepeatabilityEstimate, estimate_repeatability
from twin.units import UM_PER_MM

REFUSAL_CONFIDENCE = 0.99
"""Confidence with which the probe must exceed its limit before a run is refused. Without it, five touches of a probe
exactly at its limit would refuse every second run."""


@dataclass(frozen=True)
class ProbeCheck:
    """Rules of the probe check. `touches` is the number of touches at the pole of a ball, and `limit_mm` is the limit
    of 2σ, twice the standard deviation of these touches."""

    touches: int
    limit_mm: float


@dataclass(frozen=True)
class Repeatability:
    """Repeatability of the probe, stated as twice the standard deviation (2σ) of `touches` touches at the pole of a
    ball. `interval_um` is the confidence interval of 2σ at the level `confidence`."""

    two_sigma_um: float
    limit_um: float
    touches: int
    interval_um: tuple[float, float]
    confidence: float
    verdict: str

    @property
    def text(self) -> str:
        low, high = self.interval_um
        return (
            f"2σ {self.two_sigma_um:.2f} µm of {self.touches} touches ({self.confidence:.0%} confidence: {low:.2f} to "
            f"{high:.2f} µm), limit {self.limit_um:g} µm: {self.verdict}"
        )


def check_repeatability(key: str, centre: Vector, probing: ProbingParameters, check: ProbeCheck) -> Plan[Repeatability]:
    """Touch the pole of the ball at `centre` repeatedly, and compare 2σ, twice the standard deviation of the touches,
    with `check.limit_mm`. If 2σ exceeds this limit, the series of touches is repeated once.

    Raises MeasurementFault if a touch meets nothing, or if 2σ of all touches exceeds the limit with the confidence
    `REFUSAL_CONFIDENCE` (99 %).
    """
    depths = yield from _depths(key, 0, centre, probing, check)
    if 2.0 * estimate_repeatability(depths).sigma > check.limit_mm:
        reason = _judged(estimate_repeatability(depths), check).text
        yield Record(f"{key}/again", "event", {"reason": reason, "then": f"{check.touches} touches more"})
        depths += yield from _depths(key, check.touches, centre, probing, check)
    scatter = estimate_repeatability(depths)
    result = _judged(scatter, check)
    yield Record(f"{key}/repeatability", "decision", {**vars(result), "depths_um": [d * UM_PER_MM for d in depths]})
    if 2.0 * scatter.sigma > check.limit_mm and scatter.exceeds(0.5 * check.limit_mm, REFUSAL_CONFIDENCE):
        raise MeasurementFault(
            f"the probe does not repeat: {result.text}",
            hint="check that the stylus is tight and the ball clean, then the probe's battery, cable and seat",
            step=key,
        )
    return result


def _depths(key: str, first: int, centre: Vector, probing: ProbingParameters, check: ProbeCheck) -> Plan[list[float]]:
    """Touch the pole and return the latched positions along the stylus, in mm from the ball's centre."""
    depths = []
    for number in range(first, first + check.touches):
        depths.append((yield from pole_depth_mm(f"{key}/touch-{number}", centre, probing)))
    return depths


def pole_depth_mm(key: str, centre: Vector, probing: ProbingParameters) -> Plan[float]:
    """Touch the pole of the ball at `centre` once, and return the latched position along the stylus, in mm from the
    centre. Raises MeasurementFault if the touch meets nothing."""
    touched = yield from touch_ball(key, centre, probing.directions[0], probing, probing.narrow_search)
    if touched.latched_mm is None:
        raise MeasurementFault(
            "a touch missed the ball, which had just been found",
            hint="check the probe's signal and that the artefact is clamped",
            step=key,
        )
    return float((np.array(touched.latched_mm) - centre) @ probing.stylus_axis)


def _judged(scatter: RepeatabilityEstimate, check: ProbeCheck) -> Repeatability:
    limit = 0.5 * check.limit_mm
    if scatter.sigma <= limit:
        verdict = "within"
    elif scatter.exceeds(limit, REFUSAL_CONFIDENCE):
        verdict = "beyond"
    else:
        verdict = "above, but not surely beyond"
    return Repeatability(
        two_sigma_um=2.0 * scatter.sigma * UM_PER_MM,
        limit_um=check.limit_mm * UM_PER_MM,
        touches=scatter.count,
        interval_um=(2.0 * scatter.lower * UM_PER_MM, 2.0 * scatter.upper * UM_PER_MM),
        confidence=scatter.confidence,
        verdict=verdict,
    )
