"""One ball: touches by the pattern, a sphere through the latched positions, limits, bounded repeats."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from agent.errors import MeasurementFault
from agent.execution.steps import Plan, Point, Record
from agent.probing.ball_gates import FailedGate, doubtful_touches, first_failed_gate
from agent.probing.probing_parameters import ProbingParameters, Search
from agent.probing.touch import TouchPath, point, touch_ball
from drivers.roles import Vector
from twin.artefact.sphere_fit import SphereFit, fit_sphere
from twin.errors import TwinError

__all__ = ["FittedBall", "LostBall", "measure_ball", "point"]


@dataclass(frozen=True, eq=False)
class FittedBall:
    """`centre_mm` (3,): axis positions, as displayed, at which stylus centre and ball centre coincide.

    `radius_mm`, `form_mm` and `residuals_mm` (k,) are those of the sphere with a free radius, whatever the centre was
    fitted with: they are what says that the ball is clean.
    """

    centre_mm: Vector
    covariance_mm2: NDArray[np.float64]
    radius_mm: float
    form_mm: float
    touches: int
    residuals_mm: Vector


@dataclass(frozen=True)
class LostBall:
    """Not measured, and why."""

    reason: str
    touches: int


def measure_ball(
    key: str, predicted_mm: Vector, probing: ProbingParameters, search: Search, way: TouchPath | None = None
) -> Plan[FittedBall | LostBall]:
    """Touch the ball where it is expected; clean up and repeat where a limit is broken; decide by policy.

    A ball that has to be looked for is located first, by touches of which none comes near its holder.
    A miss widens the search once; a miss of the wide search ends it. A centre that is found far from where it was
    expected is measured again from there, so that every ball is approached along the same normals.
    """
    ball = _Ball(key, predicted_mm, probing, search, way)
    if search.beside_mm_per_s is not None:
        yield from ball.located()
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
    return LostBall(ball.reason, ball.touches)


class _Ball:
    """What is known of a ball while it is attempted."""

    def __init__(
        self, key: str, predicted_mm: Vector, probing: ProbingParameters, search: Search, way: TouchPath | None
    ) -> None:
        self._key = key
        self._way = way
        self._probing = probing
        self._centre = predicted_mm
        self._search = search
        self.touches = 0
        self.reason = ""
        self.given_up = False

    def located(self) -> Plan[None]:
        """Roughly where the ball is; given up where it is not found."""
        key, probing = f"{self._key}/locate", self._probing
        latched: list[Point] = []
        for index, direction in enumerate(probing.locating):
            touched = yield from self._touched(f"{key}/touch-{index}", direction)
            if touched is None:
                yield from self._missed(key, index, last=True)
                return
            latched.append(touched)
        fit = self._sphere(np.array(latched))
        if fit is None:
            self.given_up = True
            yield Record(f"{key}/again", "event", self._note(self.reason, last=True))
            return
        yield Record(f"{key}/found", "event", {"ball": self._key, "off_mm": fit.centre - self._centre})
        self._centre, self._search = fit.centre, probing.narrow

    def attempt(self, number: int, *, last: bool) -> Plan[FittedBall | None]:
        """All touches once; None where the ball has to be attempted again, or is given up."""
        key = self._key if number == 0 else f"{self._key}/repeat-{number}"
        latched: list[Point] = []
        for index in range(len(self._probing.directions)):
            touched = yield from self._touch(f"{key}/touch-{index}", index)
            if touched is None:
                yield from self._missed(key, index, last)
                return None
            latched.append(touched)
        points = np.array(latched)
        fit = self._fitted(points)
        gate = None if fit is None or self._away_mm(fit) > self._probing.recentre_mm else self._gate(fit)
        if fit is not None and gate is not None:
            fit, points, gate = yield from self._cleaned(key, fit, points, gate)
        if fit is None:
            yield Record(f"{key}/again", "event", self._note(self.reason, last))
            return None
        return (yield from self._judged(key, fit, points, gate, number, last))

    def _judged(
        self, key: str, fit: SphereFit, points: Vector, gate: FailedGate | None, number: int, last: bool
    ) -> Plan[FittedBall | None]:
        away_mm = self._away_mm(fit)
        self._centre, self._search = fit.centre, self._probing.narrow
        if gate is not None:
            self.reason = gate.text
            yield Record(f"{key}/gate", "event", gate.payload(self._key, self._next(last)))
            return None
        if away_mm > self._probing.recentre_mm:
            self.reason = f"found {away_mm:.3f} mm from where it was expected, {number + 1} times"
            yield Record(f"{key}/again", "event", self._note(self.reason, last))
            return None
        return self._found(fit, points)

    def _cleaned(
        self, key: str, fit: SphereFit, points: Vector, gate: FailedGate
    ) -> Plan[tuple[SphereFit | None, Vector, FailedGate | None]]:
        """Doubtful touches once more, along the same lines: what was a crumb or a false trip goes away."""
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
        cleaned = self._fitted(points)
        return cleaned, points, None if cleaned is None else self._gate(cleaned)

    def _gate(self, fit: SphereFit) -> FailedGate | None:
        return first_failed_gate(fit, self._probing)

    def _away_mm(self, fit: SphereFit) -> float:
        return float(np.linalg.norm(fit.centre - self._centre))

    def _touch(self, key: str, index: int) -> Plan[Point | None]:
        return (yield from self._touched(key, self._probing.directions[index]))

    def _touched(self, key: str, direction: Vector) -> Plan[Point | None]:
        touched = yield from touch_ball(key, self._centre, direction, self._probing, self._search, self._way)
        self.touches += touched.trips
        return touched.latched_mm

    def _missed(self, key: str, index: int, last: bool) -> Plan[None]:
        self.reason = f"touch {index} met nothing"
        self.given_up = self._search.beyond_mm >= self._probing.wide.beyond_mm
        self._search = self._probing.wide
        then = self._next(last) if self.given_up or last else "search wider"
        yield Record(f"{key}/again", "event", {"ball": self._key, "reason": self.reason, "then": then})

    def _fitted(self, points: Vector) -> SphereFit | None:
        """The sphere through the touches of all directions, pretravel taken off."""
        return self._sphere(self._corrected(points))

    def _sphere(self, points: Vector) -> SphereFit | None:
        """The sphere with a free radius through `points`; None, and the reason, without one."""
        try:
            return fit_sphere(points, self._probing.touch_sigma_mm)
        except TwinError as error:
            self.reason = f"no sphere through the touches: {error}"
            return None

    def _corrected(self, points: Vector) -> Vector:
        stylus = self._probing.stylus
        if stylus is None or stylus.pretravel is None:
            return points
        return stylus.pretravel.correct(points, self._probing.directions)

    def _found(self, free: SphereFit, points: Vector) -> FittedBall:
        probing, stylus = self._probing, self._probing.stylus
        centre, covariance = free.centre, free.centre_covariance
        if stylus is not None and stylus.fixed:
            fit = fit_sphere(self._corrected(points), probing.touch_sigma_mm, stylus.radius_mm, near=free.centre)
            moved = stylus.radius_sigma_mm * probing.centre_per_radius
            centre, covariance = fit.centre, fit.centre_covariance + np.outer(moved, moved)
        return FittedBall(centre, covariance, free.radius, free.form, self.touches, free.residuals)

    def _note(self, reason: str, last: bool) -> dict[str, object]:
        return {"ball": self._key, "reason": reason, "then": self._next(last)}

    def _next(self, last: bool) -> str:
        if not (last or self.given_up):
            return "repeat the ball"
        return "stop" if self._probing.stop_on_failure else "skip the ball"
