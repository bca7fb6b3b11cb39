"""Placement of the artefact by hand. The operator is asked to place the artefact in a position, and the probe then
locates it.

The probe waits at a park location while the operator works. Afterwards, nobody knows where the artefact really stands.
The probe therefore crosses the workspace at the retreat plane and comes down along the stylus in probing moves, which
end wherever the tip meets something (see `agent.probing.probing_move`). The balls are chosen so that only the tip can
meet the artefact (see `twin.collision.locating_balls`). An artefact that is found within the tolerance is measured
where it stands. Otherwise the placement is refused, with the reason, and the operator is asked again.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from enum import Enum

import numpy as np

from agent.errors import MeasurementFault
from agent.execution.steps import (
    AskOperator,
    CheckPermissions,
    CheckProbe,
    MoveTo,
    Plan,
    ReadPosition,
    Record,
    TouchTowards,
)
from agent.probing.paths.retreat import Retreat
from agent.probing.probing_move import met_on_the_way
from agent.probing.probing_parameters import ProbingParameters
from agent.probing.touch import point
from drivers.roles import BallPlace, OperatorTask, PlacementRequest, Touch
from twin.arrays import Array
from twin.artefact.placement_tolerance import PlacementTolerance
from twin.artefact.pose_alignment import align_to_end_balls, align_to_third_ball
from twin.artefact.position_set import Position
from twin.artefact.sphere_fit import fit_sphere
from twin.collision.locating_balls import LocatingBalls, locating_balls
from twin.collision.measuring_layout import MeasuringLayout
from twin.errors import TwinError

CAP_SHARE = 0.35
"""Distance of the outer touches on a ball from the first one, as a share of the distance of the centres at contact."""
SPHERE_MM = 0.1
"""Largest residual of the touches on a ball; a rod of the artefact leaves residuals above it."""
DISTANCE_MM = 0.5
"""Largest deviation of the distance between two balls: ample for the errors of a machine, small between two balls."""
_MIN_TOUCHES = 3
COLLINEAR_SHARE = 1e-12
"""Balls are on one line if their second largest singular value is below this share of the largest."""


class PlacementFault(Enum):
    """Reason for which a placement is refused."""

    NOT_FOUND = "not-found"
    OBSTRUCTED = "obstructed"
    NO_BALL = "no-ball"
    OTHER_DISTANCE = "other-distance"
    TOO_FAR = "too-far"
    TURNED = "turned"
    LOST = "lost"


@dataclass(frozen=True)
class PlacementRefusal:
    """Refused placement: the reason as a code and as text, and the ball that it concerns."""

    fault: PlacementFault
    text: str
    ball: int | None = None


@dataclass(frozen=True)
class HandPlacement:
    """Rules for an artefact that is placed by hand.

    An artefact farther than `tolerance` from its nominal position is refused. The operator is asked up to `attempts`
    times for each position. The probe comes down at `search_feed_mm_per_s` until the tip meets something, and touches a
    ball at `touch_feed_mm_per_s` to locate it.
    """

    tolerance: PlacementTolerance
    attempts: int
    search_feed_mm_per_s: float
    touch_feed_mm_per_s: float


@dataclass(frozen=True, eq=False)
class PlacementTask:
    """Position in which the artefact is to be placed.

    `nominal_mm` (N, 3) holds the axis positions of all N balls if the artefact stands exactly there. `balls` are those
    by which it is located. The key of every step begins with `key`.
    """

    key: str
    position: Position
    nominal_mm: Array
    balls: LocatingBalls
    retreat: Retreat
    probing: ProbingParameters
    rules: HandPlacement

    @classmethod
    def of(
        cls,
        key: str,
        position: Position,
        layout: MeasuringLayout,
        retreat: Retreat,
        probing: ProbingParameters,
        rules: HandPlacement,
    ) -> PlacementTask:
        """Return the task for `position`. Raises MeasurementFault if the artefact cannot be located safely in it."""
        nominal = layout.nominal(position)
        reachable = [int(ball) for ball in np.flatnonzero(layout.reachable(position, nominal))]
        try:
            balls = locating_balls(layout, position, reachable)
        except TwinError as error:
            raise MeasurementFault(error.message, hint=error.hint, step=key) from error
        return cls(key, position, nominal, balls, retreat, probing, rules)


def place_artefact(task: PlacementTask, *, standing: bool, lost: PlacementRefusal | None = None) -> Plan[Array]:
    """Have the artefact placed in the position of `task` and locate it. Return the axis positions (N, 3) of its balls.

    If `standing` is True, the artefact may still stand there: it is looked for first, without a question. `lost` is the
    reason for which it has to be placed again. The probe may be at any place clear of the artefact, and it ends above
    the ball that it located last. Raises MeasurementFault if all attempts are refused.
    """
    refused = lost
    for attempt in range(0 if standing else 1, task.rules.attempts + 1):
        key = f"{task.key}/place-{attempt}"
        if attempt > 0:
            yield from _ask(key, task, refused)
        else:
            here = np.array((yield ReadPosition(f"{key}/here")))
            yield MoveTo(f"{key}/retreat", point(task.retreat.at_retreat_plane(here)))
        located = yield from _locate(key, task)
        if not isinstance(located, PlacementRefusal):
            return located
        refused = located
        ball = {} if refused.ball is None else {"ball": refused.ball}
        yield Record(f"{key}/refused", "event", {"reason": f"placement refused: {refused.text}", **ball})
    raise MeasurementFault(
        f"the artefact was placed {task.rules.attempts} times, and every placement was refused; the last one because "
        f"{refused.text if refused else ''}",
        hint="check the position, the artefact file and stations.placement_tolerance_mm",
        step=task.key,
    )


def _ask(key: str, task: PlacementTask, refused: PlacementRefusal | None) -> Plan[None]:
    """Wait for the operator at the retreat plane, beside the station if the way there is free."""
    here = np.array((yield ReadPosition(f"{key}/here")))
    yield MoveTo(f"{key}/retreat", point(task.retreat.at_retreat_plane(here)))
    # An artefact that was not located may stand in the way. The probe is then back where it was, and waits there.
    yield from _met_across(f"{key}/beside", task, task.retreat.park_location(here, task.position.station))
    yield AskOperator(f"{key}/by-hand", placement_request(task, refused))
    yield CheckPermissions(f"{key}/permissions")
    yield CheckProbe(f"{key}/probe")


def placement_request(task: PlacementTask, refused: PlacementRefusal | None = None) -> PlacementRequest:
    """Return the request to the operator, in words and in figures."""
    position = task.position
    balls = tuple(
        BallPlace(ball, (round(x, 1), round(y, 1), round(z, 1)))
        for ball, (x, y, z) in ((ball, task.nominal_mm[ball].tolist()) for ball in task.balls.all)
    )
    pose = f"station {position.station}, azimuth {position.azimuth_deg:g}°, elevation {position.elevation_deg:g}°"
    places = "; ".join(f"ball {one.ball} at X {one.position_mm[0]:g} Y {one.position_mm[1]:g}" for one in balls)
    again = "" if refused is None else f"The last placement was refused: {refused.text}. "
    return PlacementRequest(
        OperatorTask.PLACE_ARTEFACT,
        f"{again}Place the artefact by hand: {pose}. {places} (axis positions in mm; ball {balls[0].ball} is measured "
        "first). Leave it standing freely, clear the workspace, close the doors.",
        position.station,
        azimuth_deg=position.azimuth_deg,
        elevation_deg=position.elevation_deg,
        balls=balls,
        refused="" if refused is None else refused.fault.value,
        refused_ball=None if refused is None else refused.ball,
    )


def _locate(key: str, task: PlacementTask) -> Plan[Array | PlacementRefusal]:
    """Locate the artefact by its locating balls. Return the axis positions (N, 3) of all its balls, or the reason for
    which the placement is refused."""
    nominal, first, second, third = task.nominal_mm, task.balls.first, task.balls.second, task.balls.third
    found: dict[int, Array] = {}
    expected = nominal
    for ball in task.balls.all:
        centre = yield from _find_ball(f"{key}/ball-{ball:02d}", task, ball, expected[ball])
        if isinstance(centre, PlacementRefusal):
            return centre
        found[ball] = centre
        refusal = _wrong_distance(nominal, found, ball)
        if refusal is not None:
            return refusal
        if ball == first:
            expected = nominal + (centre - nominal[first])
        elif ball == second:
            expected = align_to_end_balls(nominal, first, second, found[first], found[second])
        else:
            assert third is not None  # noqa: S101  the last of three
            expected = align_to_third_ball(expected, first, second, third, centre)
    shift_mm, turn_deg = deviation(nominal, expected)
    tolerance = task.rules.tolerance
    yield Record(f"{key}/located", "event", {"shift_mm": round(shift_mm, 3), "turn_deg": round(turn_deg, 3)})
    if turn_deg > tolerance.angle_deg:
        text = f"the artefact is turned by {turn_deg:.1f}°, allowed {tolerance.angle_deg:g}°"
        return PlacementRefusal(PlacementFault.TURNED, text)
    if shift_mm > tolerance.distance_mm:
        text = f"the artefact is {shift_mm:.1f} mm from its place, allowed {tolerance.distance_mm:g} mm"
        return PlacementRefusal(PlacementFault.TOO_FAR, text)
    return expected


def deviation(nominal: Array, found: Array) -> tuple[float, float]:
    """Return the displacement in mm of the mean of the balls, and the rotation in degrees, by which the rigid artefact
    `nominal` (N, 3) becomes `found` (N, 3). Balls on one line do not show a rotation about it, which is not counted."""
    shift = found.mean(axis=0) - nominal.mean(axis=0)
    # The rotation R minimises Σ|R a − b|²; from the singular value decomposition of Σ a bᵀ (Kabsch).
    left, spread, right = np.linalg.svd((nominal - nominal.mean(axis=0)).T @ (found - found.mean(axis=0)))
    if spread[1] < COLLINEAR_SHARE * spread[0]:
        cosine = float(left[:, 0] @ right[0])
    else:
        sign = np.sign(np.linalg.det(left @ right))
        rotation = left @ np.diag([1.0, 1.0, sign]) @ right
        cosine = 0.5 * (float(np.trace(rotation)) - 1.0)
    return float(np.linalg.norm(shift)), math.degrees(math.acos(min(1.0, max(-1.0, cosine))))


def _wrong_distance(nominal: Array, found: dict[int, Array], ball: int) -> PlacementRefusal | None:
    for other, centre in found.items():
        expected = float(np.linalg.norm(nominal[ball] - nominal[other]))
        measured = float(np.linalg.norm(found[ball] - centre))
        if abs(measured - expected) > DISTANCE_MM:
            text = (
                f"the balls {other} and {ball} are {measured:.1f} mm apart instead of {expected:.1f} mm, so the "
                "artefact is turned the wrong way or is another one"
            )
            return PlacementRefusal(PlacementFault.OTHER_DISTANCE, text, ball)
    return None


def _find_ball(key: str, task: PlacementTask, ball: int, expected: Array) -> Plan[Array | PlacementRefusal]:
    """Find the ball that is expected near the axis positions `expected` (3,); return its centre (3,)."""
    first = yield from _descend(key, task, expected)
    if isinstance(first, PlacementRefusal):
        return replace(first, ball=ball)
    if first is None:
        text = f"ball {ball} was not found at its place or within {_reach_mm(task):.0f} mm around it"
        return PlacementRefusal(PlacementFault.NOT_FOUND, text, ball)
    probing, up = task.probing, -task.probing.stylus_axis
    too_high_mm = float((first - expected) @ up) - probing.contact_mm - _too_high_mm(task)
    if too_high_mm > 0.0:
        yield from _raise(key, task)
        text = f"something stands {too_high_mm + _too_high_mm(task):.0f} mm above the place of ball {ball}"
        return PlacementRefusal(PlacementFault.OBSTRUCTED, text, ball)
    points = yield from _touch_cap(key, task, first)
    centre = _fit(points, probing, first)
    yield from _raise(key, task)
    if centre is None:
        return PlacementRefusal(
            PlacementFault.NO_BALL, f"what was touched at the place of ball {ball} is not a ball", ball
        )
    return centre


def _descend(key: str, task: PlacementTask, expected: Array) -> Plan[Array | PlacementRefusal | None]:
    """Come down to the expected place of a ball and, if nothing is there, around it. Return the axis positions (3,) of
    the first contact, None if there was none, or the refusal if the tip met something at the retreat plane already."""
    probing, retreat, rules = task.probing, task.retreat, task.rules
    deepest = expected - probing.stylus_axis * (probing.contact_mm - probing.wide_search.beyond_mm)
    for number, aside in enumerate(search_columns(rules.tolerance, probing)):
        target = deepest + aside
        if (yield from _met_across(f"{key}/over-{number}", task, retreat.at_retreat_plane(target))):
            text = "the artefact or something else stands so high that the probe met it at the retreat plane"
            return PlacementRefusal(PlacementFault.OBSTRUCTED, text)
        result = yield TouchTowards(f"{key}/down-{number}", point(target), rules.search_feed_mm_per_s)
        if isinstance(result, Touch):
            return np.array(result.position_mm)
        yield MoveTo(f"{key}/up-{number}", point(retreat.at_retreat_plane(target)))
    return None


def search_columns(tolerance: PlacementTolerance, probing: ProbingParameters) -> Iterator[Array]:
    """Return the displacements (3,) perpendicular to the stylus at which a ball is looked for: the middle, and rings
    around it that leave no gap as large as a ball."""
    one, other = _across(probing)
    yield np.zeros(3)
    step = 1.2 * probing.contact_mm
    for ring in range(1, math.ceil(max(0.0, tolerance.distance_mm - 0.6 * probing.contact_mm) / step) + 1):
        count = 6 * ring
        for number in range(count):
            angle = 2.0 * math.pi * number / count
            yield ring * step * (math.cos(angle) * one + math.sin(angle) * other)


def _reach_mm(task: PlacementTask) -> float:
    """Return the distance in mm from its place at which a ball is still met."""
    farthest = max(float(np.linalg.norm(aside)) for aside in search_columns(task.rules.tolerance, task.probing))
    return farthest + 0.8 * task.probing.contact_mm


def _too_high_mm(task: PlacementTask) -> float:
    return task.rules.tolerance.distance_mm + 1.0


def _touch_cap(key: str, task: PlacementTask, first: Array) -> Plan[list[Array]]:
    """Touch around the first contact, along the stylus; return all contacts, the first one included.

    Between two touches the tip is raised so far that it clears the ball wherever the first contact was on it.
    """
    probing, rules = task.probing, task.rules
    points, lift = [first], -probing.stylus_axis * probing.contact_mm
    one, other = _across(probing)
    yield MoveTo(f"{key}/lift", point(first + lift))
    for number, direction in enumerate((one, other, -one, -other)):
        beside = first + CAP_SHARE * probing.contact_mm * direction
        if (yield from _met_across(f"{key}/beside-{number}", task, beside + lift)):
            break
        result = yield TouchTowards(f"{key}/cap-{number}", point(beside - lift), rules.touch_feed_mm_per_s)
        yield MoveTo(f"{key}/lift-{number}", point(beside + lift))
        if isinstance(result, Touch):
            points.append(np.array(result.position_mm))
    return points


def _fit(points: list[Array], probing: ProbingParameters, first: Array) -> Array | None:
    """Return the centre (3,) of a ball through the contacts, None if they are not on a ball."""
    if len(points) < _MIN_TOUCHES:
        return None
    near = first + probing.stylus_axis * probing.contact_mm
    try:
        fit = fit_sphere(np.array(points), probing.touch_sigma_mm, probing.expected_radius_mm, near=near)
    except TwinError:
        return None
    return fit.centre if float(np.abs(fit.residuals).max()) <= SPHERE_MM else None


def _met_across(key: str, task: PlacementTask, target: Array) -> Plan[bool]:
    return (yield from met_on_the_way(key, target, task.rules.search_feed_mm_per_s))


def _raise(key: str, task: PlacementTask) -> Plan[None]:
    here = np.array((yield ReadPosition(f"{key}/lifted")))
    yield MoveTo(f"{key}/raise", point(task.retreat.at_retreat_plane(here)))


def _across(probing: ProbingParameters) -> tuple[Array, Array]:
    """Return the unit vectors (3,) of the two axes perpendicular to the stylus."""
    one, other = (axis for axis in np.eye(3) if abs(float(axis @ probing.stylus_axis)) < 0.5)
    return one, other
