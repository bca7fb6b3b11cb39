"""Preparation of a run by checks on one ball of the artefact. The ball is located, the probe and the delay of its latch
are checked, the stylus is qualified, and the lost motion of the axes at reversal is measured."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from agent.errors import MeasurementFault, PlacementLost
from agent.execution.steps import CheckPermissions, CheckProbe, MoveTo, OrientTo, Plan, ReadPosition, Record
from agent.probing.ball import FittedBall, LostBall, measure_ball, point
from agent.probing.hand_placement import HandPlacement, PlacementFault, PlacementRefusal, PlacementTask, place_artefact
from agent.probing.latch_delay import LatchDelay, measure_latch_delay
from agent.probing.lost_ball import lost_ball_fault
from agent.probing.paths.shortest_path import create_path_planner
from agent.probing.position import PositionRules
from agent.probing.probe_check import ProbeCheck, Repeatability, check_repeatability
from agent.probing.qualification import Qualification, QualificationRules, qualify_stylus
from agent.probing.reversal import AxisReversal, Reversal, ReversalCheck, measure_reversal
from agent.probing.run_plan import MeasuringOrder, placed_planner, position_key
from agent.probing.station_change import change_station, park_mounts
from twin.arrays import Array
from twin.artefact.position_set import Position
from twin.collision.measuring_layout import MeasuringLayout


@dataclass(frozen=True, eq=False)
class Preparation:
    """Checks that are made before a run. A check is left out if its rules (`check`, `qualification` or `reversal`) are
    None. The delay of the latch is measured with `latch_touches` touches at each of two feeds, or not at all if this is
    0.

    `layout` is a layout in which a ball counts as reachable only if it is accessible for the dense touch pattern of the
    stylus qualification and for the moves of the checks.
    """

    check: ProbeCheck | None
    qualification: QualificationRules | None
    layout: MeasuringLayout
    reversal: ReversalCheck | None = None
    latch_touches: int = 0

    @property
    def is_empty(self) -> bool:
        return (self.check, self.qualification, self.reversal) == (None, None, None) and self.latch_touches == 0


@dataclass(frozen=True, eq=False)
class DatumBall:
    """Ball on which the checks before a run are made: its number `ball` in the position `position` of the artefact, the
    axis positions `expected_mm` (3,) at which it was expected, and the ball as it was found."""

    position: Position
    ball: int
    expected_mm: Array
    found: FittedBall

    @property
    def text(self) -> str:
        x, y, z = self.found.centre_mm - self.expected_mm
        return (
            f"ball {self.ball} at station {self.position.station}, azimuth {self.position.azimuth_deg:g}°, elevation "
            f"{self.position.elevation_deg:g}°; found X {x:+.3f}, Y {y:+.3f}, Z {z:+.3f} mm beside its expected place"
        )


@dataclass(frozen=True, eq=False)
class PreparationResult:
    """Result of the preparation of a run by checks of the probe, the stylus and the axes. `rules` are the measuring
    rules with the qualified stylus, and `standing_at` is the station at which the artefact stands afterwards. `placed`
    is the position in which an artefact that is placed by hand stands afterwards. `datum` is the ball of the checks."""

    rules: PositionRules
    standing_at: int | None
    datum: DatumBall | None = None
    repeatability: Repeatability | None = None
    latch: LatchDelay | None = None
    qualification: Qualification | None = None
    reversal: Reversal | None = None
    placed: Position | None = None

    @property
    def reversals(self) -> tuple[AxisReversal, ...]:
        """Lost motion of X, Y and Z at reversal of the axes; empty if the lost motion was not measured."""
        return () if self.reversal is None else self.reversal.axes


PREFIX = "probe"


def prepare_probe(
    order: MeasuringOrder, layout: MeasuringLayout, rules: PositionRules, preparation: Preparation
) -> Plan[PreparationResult]:
    """Carry out the checks listed in `preparation` on the datum ball, which is the first suitable ball of the positions
    in `order`.

    The probe may be anywhere at the start. After the checks, it is moved clear of the artefact (see
    `PathPlanner.leave`). Raises MeasurementFault if no ball is suitable, if the ball is not found or exceeds its
    limits, if the probe's repeatability is too poor, or if the lost motion is too large.
    """
    yield from _park_all_mounts(rules)
    if preparation.is_empty:
        return PreparationResult(rules, order.standing_at)
    position, ball, preparation = yield from _datum_ball(order, layout, preparation)
    key = f"{PREFIX}/{position_key(position)}"
    yield CheckPermissions(f"{key}/permissions")
    yield CheckProbe(f"{key}/probe")
    if rules.placement is not None:
        return (yield from _prepare_placed(key, position, ball, layout, rules, rules.placement, preparation))
    if position.station != order.standing_at:
        here = np.array((yield ReadPosition(f"{key}/before")))
        yield from change_station(
            PREFIX, rules.change, rules.retreat, here, leaving=order.standing_at, to=position.station, index=0
        )
    predicted = layout.nominal(position)[ball]
    yield from _go_to_ball(key, position, predicted, rules)
    found = yield from _locate_ball(f"{key}/ball-{ball:02d}", predicted, rules)
    datum = DatumBall(position, ball, predicted, found)
    prepared = yield from _carry_out(f"{key}/ball-{ball:02d}", datum, rules, preparation)
    planner = create_path_planner(rules.retreat, rules.probing, layout)
    yield from planner.take_over(key, position, ball, found.centre_mm)
    yield from planner.leave(key, found.centre_mm)
    return replace(prepared, standing_at=position.station)


def _prepare_placed(
    key: str,
    position: Position,
    ball: int,
    layout: MeasuringLayout,
    rules: PositionRules,
    placement: HandPlacement,
    preparation: Preparation,
) -> Plan[PreparationResult]:
    """Carry out the checks on an artefact that is placed by hand. If it has to be placed again meanwhile, repeat all
    checks."""
    lost: PlacementRefusal | None = None
    for attempt in range(placement.attempts):
        own = key if attempt == 0 else f"{key}/again-{attempt}"
        try:
            task = PlacementTask.of(own, position, layout, rules.retreat, rules.probing, placement)
            located = yield from place_artefact(task, standing=attempt > 0, lost=lost)
            planner = placed_planner(position, layout, rules)
            yield from planner.to_ball(own, located[ball])
            found = yield from _locate_ball(f"{own}/ball-{ball:02d}", located[ball], rules)
            datum = DatumBall(position, ball, located[ball], found)
            prepared = yield from _carry_out(f"{own}/ball-{ball:02d}", datum, rules, preparation)
            yield from planner.from_ball(own, found.centre_mm)
        except PlacementLost as error:
            yield Record(f"{own}/placement-lost", "event", {"reason": error.message})
            lost = PlacementRefusal(PlacementFault.LOST, error.message)
            continue
        return replace(prepared, standing_at=position.station, placed=position)
    raise MeasurementFault(
        f"the artefact was moved {placement.attempts} times while the probe was being checked",
        hint="leave it standing until the next request",
        step=key,
    )


def _park_all_mounts(rules: PositionRules) -> Plan[None]:
    """Park all mounts, because the pose in which a person or an earlier run left them is not known."""
    if rules.change.own_mounts:
        yield CheckPermissions(f"{PREFIX}/mounts/permissions")
        here = np.array((yield ReadPosition(f"{PREFIX}/mounts/here")))
        yield from park_mounts(PREFIX, "mounts", rules.change, rules.retreat, here, rules.change.own_mounts)


def _carry_out(key: str, datum: DatumBall, rules: PositionRules, preparation: Preparation) -> Plan[PreparationResult]:
    repeatability = latch = qualification = reversal = None
    probing, centre = rules.probing, datum.found.centre_mm
    if preparation.check is not None:
        repeatability = yield from check_repeatability(f"{key}/check", centre, probing, preparation.check)
    if preparation.latch_touches:
        latch = yield from measure_latch_delay(f"{key}/latch", centre, probing, preparation.latch_touches)
    if preparation.qualification is not None:
        qualification = yield from qualify_stylus(f"{key}/qualify", centre, probing, preparation.qualification)
        probing = probing.qualified(qualification.stylus)
    if preparation.reversal is not None:
        reversal = yield from measure_reversal(f"{key}/reversal", centre, probing, preparation.reversal)
    rules = replace(rules, probing=probing)
    return PreparationResult(rules, None, datum, repeatability, latch, qualification, reversal)


def _go_to_ball(key: str, position: Position, predicted: Array, rules: PositionRules) -> Plan[None]:
    retreat = rules.retreat
    here = np.array((yield ReadPosition(f"{key}/here")))
    yield MoveTo(f"{key}/retreat", point(retreat.at_retreat_plane(here)))
    yield MoveTo(f"{key}/park", point(retreat.park_location(here, position.station)))
    yield OrientTo(f"{key}/orient", position.station, position.azimuth_deg, position.elevation_deg)
    above = retreat.withdrawn_from(predicted, rules.probing)
    yield MoveTo(f"{key}/enter", point(retreat.at_retreat_plane(above)))
    yield MoveTo(f"{key}/approach", point(above))


def _locate_ball(key: str, predicted: Array, rules: PositionRules) -> Plan[FittedBall]:
    """Measure the ball with the locating search and the run's touch pattern, or with the smallest one that determines
    its radius. Raises MeasurementFault if it is lost."""
    probing = rules.probing.determining_radius()
    result = yield from measure_ball(key, predicted, probing, probing.locating_search)
    if isinstance(result, LostBall):
        raise (yield from lost_ball_fault(key, "the ball for the probe check", result, rules.probing))
    yield Record(f"{key}/found", "event", {"centre_mm": result.centre_mm, "form_um": result.form_mm * 1e3})
    return result


def _datum_ball(
    order: MeasuringOrder, layout: MeasuringLayout, preparation: Preparation
) -> Plan[tuple[Position, int, Preparation]]:
    """Return position and number of the first ball accessible for the dense pattern, and the preparation to be made.

    If no ball is accessible for the dense pattern, the reversal check is left out, and the probe check is made on any
    reachable ball. Raises MeasurementFault if a qualification is requested or no ball can be used.
    """
    wanted = preparation.qualification.ball if preparation.qualification else None
    free = _first_free_ball(order, (preparation.layout, layout), wanted)
    if free is not None:
        return *free, preparation
    anywhere = _first_free_ball(order, (layout,), wanted) if preparation.qualification is None else None
    if anywhere is not None:
        reason = "the reversal of the axes cannot be measured: no ball of this run is accessible from all directions"
        yield Record(f"{PREFIX}/no-free-ball", "event", {"reason": reason})
        return *anywhere, replace(preparation, reversal=None)
    name = "no ball" if wanted is None else f"ball {wanted} in no position"
    raise MeasurementFault(
        f"the stylus cannot be qualified: {name} of this run is accessible from all directions",
        hint="set another ball in qualification.ball, add a position with free access to the artefact, or disable the "
        "qualification",
    )


def _first_free_ball(
    order: MeasuringOrder, layouts: Sequence[MeasuringLayout], wanted: int | None
) -> tuple[Position, int] | None:
    """Return the first position and its first ball that is reachable in all `layouts`; None if there is none. If
    `wanted` is a number, only the ball with this number is considered."""
    for position in order.positions:
        nominal = layouts[0].nominal(position)
        free = np.logical_and.reduce([layout.reachable(position, nominal) for layout in layouts])
        balls = [int(ball) for ball in np.flatnonzero(free) if wanted in (None, int(ball))]
        if balls:
            return position, balls[0]
    return None
