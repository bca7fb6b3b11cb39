"""Measurement of one ball. The ball is touched in a fixed pattern of directions, a sphere is fitted to the touches, and
the fitted sphere is checked against limits. If a limit is exceeded, the measurement is repeated a few times.

Gates (limits) that a fitted ball must pass, and the choice of the touches that are repeated if the ball fails a
gate.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from agent.errors import MeasurementFault
from agent.execution.steps import Plan, Point, Record
from agent.probing.probing_parameters import ProbingParameters, Search
from agent.probing.touch import TouchPath, point, touch_ball
from drivers.roles import Vector
from twin.artefact.sphere_fit import SphereFit, fit_sphere
from twin.errors import TwinError
from twin.units import UM_PER_MM

__all__ = ["NOT_FOUND_HINT", "FittedBall", "LostBall", "SmallSphere", "measure_ball", "point"]
NOT_FOUND_HINT = (
    "deflect the stylus by hand: `volcal doctor` must show it. Then check the station's location in the settings, the "
    "mount's zero and the artefact's seat"
)
"""What to do if a ball whose place is not known yet was not found."""
RADIUS = "radius"
"""Name of the gate of the radius."""
TIE_RATIO = 0.95
"""Fraction of the largest standardised residual above which a touch cannot be distinguished from the worst touch.

The actual touch directions deviate from the pattern, because the ball may be off its expected centre by up to the
re-centring limit, a few percent of its radius."""
MIN_POLE_REDUNDANCY = 0.05
"""Redundancy of the pole touch below which the other touches do not determine the sphere at the pole."""


@dataclass(frozen=True, eq=False)
class FittedBall:
    """Sphere fitted to the touches of one ball. `centre_mm` (3,) holds the axis positions, as the controller displays
    them, at which the centres of stylus tip and ball coincide.

    `radius_mm`, `form_mm` (form error) and `residuals_mm` (k,), with one residual for each of the k touches, belong to
    a sphere fitted with a free radius. This holds even if the centre was fitted with a fixed radius, because only the
    values of a free radius show whether the ball is clean. If the touches do not determine a radius, `radius_mm` and
    `form_mm` are NaN and the residuals are zero; the ball is then checked against the other balls of its position.
    """

    centre_mm: Vector
    covariance_mm2: NDArray[np.float64]
    radius_mm: float
    form_mm: float
    touches: int
    residuals_mm: Vector


@dataclass(frozen=True, eq=False)
class SmallSphere:
    """Sphere through the touches of a ball whose radius is too small by `deficit_mm`, with its centre (3,)."""

    centre_mm: Vector
    deficit_mm: float


@dataclass(frozen=True)
class LostBall:
    """Ball that could not be measured, with the reason in words and the number of touches made. If it was given up
    because its radius is too small, `small` is the sphere that was found."""

    reason: str
    touches: int
    small: SmallSphere | None = None


def measure_ball(
    key: str, predicted_mm: Vector, probing: ProbingParameters, search: Search, path: TouchPath | None = None
) -> Plan[FittedBall | LostBall]:
    """Measure the ball that is expected at the axis positions `predicted_mm` (3,), and repeat the measurement if it
    fails.

    If the sphere fitted to the touches exceeds a limit, the touches that may have caused this are repeated first, then
    all touches of the ball. If the ball is found far from its expected centre, it is measured again about the centre
    found, because all balls must be touched along the same surface normals. This is done at rapid traverse if the
    touches determine the radius and agree with each other. Otherwise, the ball may have been moved between its touches:
    whatever is repeated is approached with the long search distances and the feed for a ball whose location is not
    known. If `search.guarded_feed_mm_per_s` is set, because the location of the ball is not known, the ball is first
    located by touches that stay away from its holder.

    After the first touch that meets nothing (a miss), these longer distances and that feed are used, too. If a touch
    with these distances misses, the ball is given up. If the ball is given up or all repeats fail,
    MeasurementFault is raised if `probing.stop_on_failure` is set; otherwise, the result is a LostBall.
    """
    ball = _Ball(key, predicted_mm, probing, search, path)
    if search.guarded_feed_mm_per_s is not None:
        yield from ball.locate()
    for attempt in range(0 if ball.given_up else 1 + probing.repeats):
        found = yield from ball.attempt(attempt, last=attempt == probing.repeats)
        if found is not None:
            return found
        if ball.given_up:
            break
    if probing.stop_on_failure:
        raise MeasurementFault(
            f"the ball could not be measured: {ball.reason}",
            hint="clean the ball and the stylus, check that both are tight and where the artefact stands",
            step=key,
        )
    return LostBall(ball.reason, ball.touches, ball.small)


class _Ball:
    """State of the measurement of one ball: its expected centre, the search in use, and the touches made."""

    def __init__(
        self, key: str, predicted_mm: Vector, probing: ProbingParameters, search: Search, path: TouchPath | None
    ) -> None:
        self._key = key
        self._path = path
        self._probing = probing
        self._centre = predicted_mm
        self._search = search
        self.touches = 0
        self.reason = ""
        self.small: SmallSphere | None = None
        self.given_up = False

    def locate(self) -> Plan[None]:
        """Locate the ball roughly; if it is not found, give up its measurement."""
        key, probing = f"{self._key}/locate", self._probing
        latched: list[Point] = []
        for index, direction in enumerate(probing.locating_directions):
            touched = yield from self._touch_along(f"{key}/touch-{index}", direction)
            if touched is None:
                yield from self._note_miss(key, index, last=True)
                return
            latched.append(touched)
        fit = self._fit_sphere(np.array(latched))
        if fit is None:
            self.given_up = True
            yield Record(f"{key}/again", "event", self._note(self.reason, last=True))
            return
        yield Record(f"{key}/found", "event", {"ball": self._key, "off_mm": fit.centre - self._centre})
        # Touches that lie on no sphere of this ball may have met one that moves: its location is still not known.
        wrong_mm = max(fit.form, abs(fit.radius - probing.contact_mm))
        self._centre = fit.centre
        self._search = probing.narrow_search if wrong_mm <= probing.recentre_mm else probing.locating_search

    def attempt(self, number: int, *, last: bool) -> Plan[FittedBall | None]:
        """Make all touches once; return None if the ball must be measured again or is given up."""
        key = self._key if number == 0 else f"{self._key}/repeat-{number}"
        latched: list[Point] = []
        for index in range(len(self._probing.directions)):
            touched = yield from self._touch(f"{key}/touch-{index}", index)
            if touched is None:
                yield from self._note_miss(key, index, last)
                return None
            latched.append(touched)
        points = np.array(latched)
        fit = self._fit_corrected(points)
        gate = None if fit is None else self._gate(fit)
        if fit is not None and gate is not None:
            self._search = self._probing.locating_search
            fit, points, gate = yield from self._repeat_doubtful(key, fit, points, gate)
        if fit is None:
            # Touches that lie on no sphere, or of which one met nothing when it was repeated, may have met a ball that
            # moves. Their centre is known no better than before.
            self._search, self.small = self._probing.locating_search, None
            yield Record(f"{key}/again", "event", self._note(self.reason, last))
            return None
        return (yield from self._judge(key, fit, points, gate, number, last))

    def _judge(
        self, key: str, fit: SphereFit, points: Vector, gate: FailedGate | None, number: int, last: bool
    ) -> Plan[FittedBall | None]:
        """Return the ball if it is as expected; otherwise choose the centre and the search of its repetition.

        The tip approaches the repetition at rapid traverse only if the touches prove where the ball is: they determine
        more than its centre, and agree. Otherwise, the ball may have moved between them, and may be near none of the
        places where they met it.
        """
        probing, distance_mm = self._probing, self._distance_mm(fit)
        is_proved = gate is None and probing.determines_radius
        self._centre, self._search = fit.centre, probing.narrow_search if is_proved else probing.locating_search
        deficit_mm = probing.expected_radius_mm - fit.radius
        contradicts = fit.form > probing.recentre_mm
        is_small = gate is not None and gate.gate == RADIUS and deficit_mm > 0.0 and not contradicts
        self.small = SmallSphere(fit.centre, deficit_mm) if is_small else None
        if contradicts:
            self.reason = f"its touches contradict each other by {fit.form:.3f} mm"
            yield Record(f"{key}/again", "event", self._note(self.reason, last))
            return None
        if gate is not None:
            self.reason = gate.text
            yield Record(f"{key}/gate", "event", gate.payload(self._key, self._next(last)))
            return None
        if distance_mm > probing.recentre_mm:
            self.reason = f"found {distance_mm:.3f} mm from where it was expected, {number + 1} times"
            yield Record(f"{key}/again", "event", self._note(self.reason, last))
            return None
        return self._result(fit, points)

    def _repeat_doubtful(
        self, key: str, fit: SphereFit, points: Vector, gate: FailedGate
    ) -> Plan[tuple[SphereFit | None, Vector, FailedGate | None]]:
        """Repeat the doubtful touches along the same lines. This replaces false trips, and touches made on a loose
        particle."""
        again = doubtful_touches(fit, self._probing)
        then = f"clean-up of touch {', '.join(str(index) for index in again)}"
        yield Record(f"{key}/clean-up", "event", gate.payload(self._key, then))
        points = points.copy()
        for index in again:
            touched = yield from self._touch(f"{key}/clean-up/touch-{index}", index)
            if touched is None:
                self.reason = f"touch {index} met nothing when it was repeated"
                return None, points, gate
            points[index] = touched
        cleaned = self._fit_corrected(points)
        return cleaned, points, None if cleaned is None else self._gate(cleaned)

    def _gate(self, fit: SphereFit) -> FailedGate | None:
        return first_failed_gate(fit, self._probing)

    def _distance_mm(self, fit: SphereFit) -> float:
        return float(np.linalg.norm(fit.centre - self._centre))

    def _touch(self, key: str, index: int) -> Plan[Point | None]:
        return (yield from self._touch_along(key, self._probing.directions[index]))

    def _touch_along(self, key: str, direction: Vector) -> Plan[Point | None]:
        touched = yield from touch_ball(key, self._centre, direction, self._probing, self._search, self._path)
        self.touches += touched.touches
        return touched.latched_mm

    def _note_miss(self, key: str, index: int, last: bool) -> Plan[None]:
        self.reason, self.small = f"touch {index} met nothing", None
        self.given_up = self._search.beyond_mm >= self._probing.wide_search.beyond_mm
        # The ball is farther away than the search was long, and no one knows in which direction.
        self._search = self._probing.locating_search
        then = self._next(last) if self.given_up or last else "search wider"
        yield Record(f"{key}/again", "event", {"ball": self._key, "reason": self.reason, "then": then})

    def _fit_corrected(self, points: Vector) -> SphereFit | None:
        """Fit a sphere to the touches of the whole pattern, corrected for pretravel. Its radius is free if the touches
        determine it."""
        probing = self._probing
        radius = None if probing.determines_radius else probing.expected_radius_mm
        return self._fit_sphere(self._corrected(points), radius)

    def _fit_sphere(self, points: Vector, radius_mm: float | None = None) -> SphereFit | None:
        """Fit a sphere to `points`, with a free radius if `radius_mm` is None. If the fit fails, set `reason` and
        return None."""
        try:
            near = None if radius_mm is None else self._centre
            return fit_sphere(points, self._probing.touch_sigma_mm, radius_mm, near=near)
        except TwinError as error:
            self.reason = f"no sphere through the touches: {error}"
            return None

    def _corrected(self, points: Vector) -> Vector:
        stylus = self._probing.stylus
        if stylus is None or stylus.pretravel is None:
            return points
        return stylus.pretravel.correct(points, self._probing.directions)

    def _result(self, free: SphereFit, points: Vector) -> FittedBall:
        probing, stylus = self._probing, self._probing.stylus
        centre, covariance = free.centre, free.centre_covariance
        if stylus is not None and stylus.fixed:
            fit = fit_sphere(self._corrected(points), probing.touch_sigma_mm, stylus.radius_mm, near=free.centre)
            moved = stylus.radius_sigma_mm * probing.centre_per_radius
            centre, covariance = fit.centre, fit.centre_covariance + np.outer(moved, moved)
        shown = probing.determines_radius
        radius, form = (free.radius, free.form) if shown else (math.nan, math.nan)
        residuals = free.residuals if shown else np.zeros(len(points))
        return FittedBall(centre, covariance, radius, form, self.touches, residuals)

    def _note(self, reason: str, last: bool) -> dict[str, object]:
        return {"ball": self._key, "reason": reason, "then": self._next(last)}

    def _next(self, last: bool) -> str:
        if not (last or self.given_up):
            return "repeat the ball"
        return "stop" if self._probing.stop_on_failure else "skip the ball"


@dataclass(frozen=True)
class FailedGate:
    """Gate (limit) that a fitted ball did not pass, with the value found (`figure_um`), the limit and a text with
    both."""

    gate: str
    figure_um: float
    limit_um: float
    text: str

    def payload(self, ball: str, then: str) -> dict[str, object]:
        """Return the payload of the journal record about this gate. `ball` is the key of the ball in the run, and
        `then` is a text that states what is done next."""
        return {
            "ball": ball,
            "gate": self.gate,
            "figure_um": round(self.figure_um, 3),
            "limit_um": self.limit_um,
            "reason": self.text,
            "then": then,
        }


def first_failed_gate(fit: SphereFit, probing: ProbingParameters) -> FailedGate | None:
    """Return the first limit of a measured ball that `fit`, a sphere fitted with a free radius, does not pass;
    None if it passes all gates."""
    limits = probing.limits
    deviation = fit.radius - probing.expected_radius_mm
    worst = int(np.abs(fit.residuals).argmax())
    pole = pole_error_mm(fit, probing)
    checks = (
        (RADIUS, deviation, limits.radius_limit_mm, "radius is off by"),
        ("form", fit.form, limits.form_limit_mm, "form is"),
        ("touch", fit.residuals[worst], limits.touch_limit_mm, f"touch {worst} is off the sphere by"),
        ("pole", 0.0 if pole is None else pole, limits.pole_limit_mm, "the pole is off the sphere through the rest by"),
    )
    for gate, value_mm, limit_mm, words in checks:
        figure_um, limit_um = float(value_mm) * UM_PER_MM, limit_mm * UM_PER_MM
        if abs(figure_um) > limit_um:
            text = f"{words} {figure_um:.1f} µm, allowed {limit_um:.1f} µm"
            return FailedGate(gate, figure_um, limit_um, text)
    return None


def pole_error_mm(fit: SphereFit, probing: ProbingParameters) -> float | None:
    """Return the distance in mm of the touch at the pole from the sphere through all other touches; None for the
    pattern of five touches, one at the pole and four on the equator.

    To first order, the distance is the residual of the pole touch divided by its redundancy, which is the fraction of a
    touch's error that appears in its residual. In the pattern of five touches, the four equator touches lie in one
    plane and determine no sphere. With that pattern, a late trip at the pole looks like a ball that is farther away.
    """
    share = float(probing.redundancies[0])
    return float(fit.residuals[0]) / share if share > MIN_POLE_REDUNDANCY else None


def doubtful_touches(fit: SphereFit, probing: ProbingParameters) -> tuple[int, ...]:
    """Return the indices of the touches to repeat: the worst touch, and each touch that the pattern of touch directions
    cannot distinguish from it.

    The redundancy of a touch is the fraction of its error that appears in its residual. To find the worst touch, each
    residual is divided by the square root of the redundancy (Baarda's test). If a pole touch and four equator touches
    are fitted with a free radius, a wrong touch on the equator changes the residuals of the four equator touches
    equally. All four are then repeated.
    """
    # Standardised residual w_i = |v_i| / √r_i; touches without redundancy have none.
    shown = np.sqrt(probing.redundancies)
    weighed = np.divide(np.abs(fit.residuals), shown, out=np.zeros_like(shown), where=shown > 0.0)
    largest = weighed.max()
    return tuple(int(i) for i in np.flatnonzero(weighed >= TIE_RATIO * largest)) if largest > 0.0 else ()
