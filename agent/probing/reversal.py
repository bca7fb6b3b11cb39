"""Lost motion of the linear axes at reversal, that is, the difference between the positions reached from either side.
It is measured by oblique touches of one ball. Before each touch, the tested axis moves to the start of the touch from
one side or from the other.

Ball centres do not show lost motion. Because the approach directions are equal on every ball, lost motion shifts all
centres equally, and a freely placed artefact cannot reveal a common shift. For this reason, lost motion is measured
separately. The report of the run states the limits of this measurement.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

from agent.errors import MeasurementFault
from agent.execution.steps import MoveTo, Plan, Record, TouchTowards
from agent.probing.probing_parameters import ProbingParameters
from agent.probing.touch import point
from drivers.roles import Touch, Vector
from twin.artefact.reversal import SLOPE, ObliqueTouch, fit_lost_motion, plan_oblique_touches
from twin.units import UM_PER_MM

PRELOAD_MM = 1.0
"""Distance in mm that the tested axis moves before a touch starts, so that the direction of its last motion is known.
It is far longer than the play of any machine, and short enough to stay clear of the ball."""
WITHIN, BEYOND = "within", "beyond"
COVERAGE_FACTOR = 2.0
"""Coverage factor: lost motion reliably exceeds its limit if the excess is more than this many standard
uncertainties."""
LIMITATION = (
    "not seen: reversal elsewhere along the travel, of the axes' angles apart from their effect at this place, of the "
    "mount's axes; none of it is in the table, which holds for the middle of both directions"
)


@dataclass(frozen=True)
class ReversalCheck:
    """Rules of the reversal check, which measures the lost motion of the axes at reversal.

    `touches` is the number of touches from each side at each of two points per axis. `limit_mm` is the largest lost
    motion that gives no warning. `stop` is True if the run stops before the first position when the lost motion of an
    axis is reliably above `limit_mm`.
    """

    touches: int
    limit_mm: float
    stop: bool


@dataclass(frozen=True)
class AxisReversal:
    """Lost motion of one axis at reversal. `lost_um` is the lost motion in µm, positive if the axis lags behind its
    display. `sigma_um` is the standard uncertainty of the lost motion. Both are None if a touch met nothing. `verdict`
    states in words whether the limit is kept. `scatter_um` is the standard deviation in µm of touches after the same
    preload, with `freedom` degrees of freedom; it is None if it was not measured."""

    axis: str
    lost_um: float | None
    sigma_um: float | None
    verdict: str
    scatter_um: float | None = None
    freedom: int = 0

    @property
    def text(self) -> str:
        if self.lost_um is None or self.sigma_um is None:
            return f"{self.axis} {self.verdict}"
        return f"{self.axis} {self.lost_um:+.1f} µm ± {COVERAGE_FACTOR * self.sigma_um:.1f} µm (2σ): {self.verdict}"


@dataclass(frozen=True)
class Reversal:
    """Lost motion of X, Y and Z at reversal, measured on a ball at the axis positions `at_mm`."""

    axes: tuple[AxisReversal, ...]
    limit_um: float
    at_mm: tuple[float, float, float]

    @property
    def noticed(self) -> tuple[AxisReversal, ...]:
        """Axes whose lost motion is above `limit_um` or could not be measured."""
        return tuple(one for one in self.axes if one.verdict != WITHIN)

    @property
    def warnings(self) -> tuple[str, ...]:
        return tuple(self._warning(one) for one in self.noticed)

    def _warning(self, one: AxisReversal) -> str:
        if one.lost_um is None:
            return f"The reversal of axis {one.text}."
        return f"Lost motion of axis {one.text}; limit {self.limit_um:g} µm. No compensation table corrects it."

    @property
    def text(self) -> str:
        at = ", ".join(f"{value:.0f}" for value in self.at_mm)
        found = "; ".join(one.text for one in self.axes)
        return f"lost motion at ({at}) mm: {found}; limit {self.limit_um:g} µm; {LIMITATION}"


def measure_reversal(key: str, centre: Vector, probing: ProbingParameters, check: ReversalCheck) -> Plan[Reversal]:
    """Measure the lost motion of X, Y and Z on the ball at `centre`. The tip starts and ends in front of the ball, in a
    plane perpendicular to the stylus.

    Raises MeasurementFault if the lost motion of an axis is reliably above `check.limit_mm` and `check.stop` requires
    that the run stops in this case.
    """
    axes = []
    for axis, name in enumerate("XYZ"):
        axes.append((yield from _measured(f"{key}/{name}", name, axis, centre, probing, check)))
    result = Reversal(tuple(axes), check.limit_mm * UM_PER_MM, point(centre))
    yield Record(f"{key}/reversal", "decision", _payload(result))
    for one, warning in zip(result.noticed, result.warnings, strict=True):
        yield Record(f"{key}/{one.axis}/reversal", "event", {"reason": warning})
    beyond = [one.text for one in result.axes if one.verdict == BEYOND]
    if beyond and check.stop:
        raise MeasurementFault(
            f"the lost motion of an axis at reversal is too large: {', '.join(beyond)}; limit {result.limit_um:g} µm",
            hint="check the controller's backlash compensation, the screw and its bearings",
            step=key,
        )
    return result


@dataclass
class _Readings:
    """Touches made with one axis, as lists for `fit_lost_motion`."""

    ratios: list[float] = field(default_factory=list)
    upwards: list[bool] = field(default_factory=list)
    places: list[int] = field(default_factory=list)
    latched_mm: list[float] = field(default_factory=list)

    def add(self, place: int, touch: ObliqueTouch, upwards: bool, latched_mm: float) -> None:
        self.places.append(place)
        self.ratios.append(touch.ratio)
        self.upwards.append(upwards)
        self.latched_mm.append(latched_mm)


def _measured(
    key: str, name: str, axis: int, centre: Vector, probing: ProbingParameters, check: ReversalCheck
) -> Plan[AxisReversal]:
    """Measure one axis with touches in the sequence up, down, down, up …, which cancels a linear drift."""
    readings = _Readings()
    for place, touch in enumerate(plan_oblique_touches(axis, probing.stylus_axis)):
        for number in range(2 * check.touches):
            upwards = number % 4 in (0, 3)
            step = f"{key}/place-{place}/touch-{number}"
            latched = yield from _touched(step, centre, touch, upwards, probing)
            if latched is None:
                yield Record(f"{step}/missed", "event", {"reason": f"reversal of {name}: a touch met nothing"})
                return AxisReversal(name, None, None, "could not be measured: a touch met nothing")
            readings.add(place, touch, upwards, latched)
    lost = fit_lost_motion(
        readings.ratios, readings.upwards, readings.places, readings.latched_mm, probing.touch_sigma_mm / SLOPE
    )
    judged = _judged(name, lost.value_mm, lost.sigma_mm, check.limit_mm)
    if lost.freedom == 0:
        return judged
    return replace(judged, scatter_um=lost.scatter_mm * UM_PER_MM, freedom=lost.freedom)


def _touched(
    key: str, centre: Vector, touch: ObliqueTouch, upwards: bool, probing: ProbingParameters
) -> Plan[float | None]:
    """Touch once and return the latched position in mm, None for a miss.

    The tested axis alone moves from `PRELOAD_MM` beside the start to the start, so that its direction is known."""
    approach_mm = max(probing.narrow_search.approach_mm, 3.0 * PRELOAD_MM)
    contact = centre + touch.normal * probing.contact_mm
    start = contact - touch.direction * approach_mm
    beside = start.copy()
    beside[touch.axis] += -PRELOAD_MM if upwards else PRELOAD_MM
    plane = probing.contact_mm + approach_mm + 2.0 * PRELOAD_MM
    above = beside - probing.stylus_axis * (plane + float((beside - centre) @ probing.stylus_axis))
    yield MoveTo(f"{key}/above", point(above))
    yield MoveTo(f"{key}/beside", point(beside))
    yield MoveTo(f"{key}/start", point(start))
    # The start is reached by the tested axis alone, so the direction of its last motion is known.
    target = contact + touch.direction * probing.narrow_search.beyond_mm
    result = yield TouchTowards(key, point(target), probing.feed_mm_per_s)
    yield MoveTo(f"{key}/back", point(above))
    return result.position_mm[touch.along] if isinstance(result, Touch) else None


def _judged(name: str, lost_mm: float, sigma_mm: float, limit_mm: float) -> AxisReversal:
    if abs(lost_mm) <= limit_mm:
        verdict = WITHIN
    elif abs(lost_mm) - COVERAGE_FACTOR * sigma_mm > limit_mm:
        verdict = BEYOND
    else:
        verdict = "above, but not surely beyond"
    return AxisReversal(name, lost_mm * UM_PER_MM, sigma_mm * UM_PER_MM, verdict)


def _payload(result: Reversal) -> Mapping[str, object]:
    return {
        "text": result.text,
        "limit_um": result.limit_um,
        "at_mm": result.at_mm,
        "axes": [dict(vars(one)) for one in result.axes],
    }
