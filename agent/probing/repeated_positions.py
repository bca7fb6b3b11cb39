"""Repetition of positions at the end of the measurements: always, as a closing look, or if the temperature of the
machine has changed during the run.

Stations are measured one after the other. A change with time therefore looks like a change along the travel: a scale of
an axis that grows with time and a nonlinear scale give the same readings. Only positions that are measured both early
and late distinguish these two causes. The artefact may have moved as a rigid body between the two measurements. Such a
motion is absorbed by the pose of the mount that is estimated for the repeated position.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, replace

from agent.execution.steps import Fork, Record, RunPlan
from agent.probing.measured_balls import MeasuredBall
from agent.probing.position import MeasuredPosition, PositionRules
from agent.probing.run_plan import MeasuredPositions, MeasuringOrder, measure_positions
from agent.thermal.readings import machine_change_k
from twin.artefact.position_set import Position
from twin.collision.measuring_layout import MeasuringLayout

REPEAT_PREFIX = "close"
ONCE, REPEATED = "measured once", "first positions repeated"


@dataclass(frozen=True)
class RepeatRules:
    """Rules for the repetition of positions at the end of a run.

    The positions `closing` are repeated in any case. If there are none and the machine's temperature changes by
    `threshold_k` or more, the first `count` measured positions that are among `candidates` are repeated. All repeated
    positions are at one station. `declared_k` is the change of temperature that is assumed if the machine has no
    thermometer.
    """

    threshold_k: float
    declared_k: float
    count: int
    candidates: Collection[Position]
    closing: tuple[Position, ...] = ()


def measure_with_repeats(
    order: MeasuringOrder,
    layout: MeasuringLayout,
    rules: PositionRules,
    repeats: RepeatRules,
    then: Callable[[MeasuredPositions], RunPlan],
) -> RunPlan:
    """Measure the positions of `order`, and positions of the first station again according to `repeats`. The run then
    continues with the plan that `then` returns for the measurements.
    """
    measured = yield from measure_positions(order, layout, rules)
    return (yield from repeat_if_changed(order.prefix, measured, layout, rules, repeats, then))


def repeat_if_changed(
    prefix: str,
    measured: MeasuredPositions,
    layout: MeasuringLayout,
    rules: PositionRules,
    repeats: RepeatRules,
    then: Callable[[MeasuredPositions], RunPlan],
) -> RunPlan:
    """Measure positions of the first station in `measured` again according to `repeats`. The run then continues with
    the plan that `then` returns for all measurements. `prefix` begins the key of the decision."""
    if repeats.closing:
        reason = "positions of the first station are measured again, to see if the machine has changed"
        return (yield from _repeated(measured, repeats.closing, reason, layout, rules, then))
    first = positions_to_repeat(measured, repeats)
    if not first:
        return (yield from then(measured))
    change_k = change_of_machine_k(measured, repeats)
    choice = REPEATED if change_k >= repeats.threshold_k else ONCE
    reason = f"the machine has changed by {change_k:.2f} K: positions of the first station are measured again"
    return Fork(
        f"{prefix}/repeat",
        lambda: choice,
        {ONCE: lambda: then(measured), REPEATED: lambda: _repeated(measured, first, reason, layout, rules, then)},
        expected=choice,
    )


def _repeated(
    measured: MeasuredPositions,
    first: tuple[Position, ...],
    reason: str,
    layout: MeasuringLayout,
    rules: PositionRules,
    then: Callable[[MeasuredPositions], RunPlan],
) -> RunPlan:
    yield Record(f"{REPEAT_PREFIX}/machine", "event", {"note": reason})
    again = MeasuringOrder(REPEAT_PREFIX, first, measured.standing_at, measured.placed)
    more = yield from measure_positions(again, layout, rules, measured.mount_poses, measured.last_conditions)
    return (yield from then(join_measured(measured, more)))


def positions_to_repeat(measured: MeasuredPositions, repeats: RepeatRules) -> tuple[Position, ...]:
    """Return the first `count` measured positions among the candidates, all at the station of the first one."""
    candidates = {position: position for position in repeats.candidates}  # with the balls that are chosen for each
    wanted = [candidates[one.position] for one in measured.positions if one.position in candidates]
    return tuple(position for position in wanted if position.station == wanted[0].station)[: repeats.count]


def change_of_machine_k(measured: MeasuredPositions, repeats: RepeatRules) -> float:
    """Return the change in K of the machine's temperature over the `measured` positions."""
    return machine_change_k([ball.conditions for ball in measured_balls(measured)], repeats.declared_k)


def measured_balls(measured: MeasuredPositions) -> list[MeasuredBall]:
    return [ball for position in measured.positions for ball in position.balls]


def join_measured(one: MeasuredPositions, other: MeasuredPositions) -> MeasuredPositions:
    """Join the measured positions `one` and `other` into one result. The position numbers of `other` are increased, so
    that they continue the numbers of `one`, unless they do so already."""
    start = max((ball.position for ball in measured_balls(one)), default=-1) + 1
    if min((ball.position for ball in measured_balls(other)), default=0) >= start:
        start = 0
    return MeasuredPositions(
        positions=(*one.positions, *(_renumbered(position, start) for position in other.positions)),
        left_out=(*one.left_out, *other.left_out),
        unreachable_balls=one.unreachable_balls + other.unreachable_balls,
        standing_at=other.standing_at,
        mount_poses=other.mount_poses,
        placed=other.placed,
    )


def drifts_um(measured: MeasuredPositions) -> Mapping[int, float]:
    """Return a mapping from position number to drift: the displacement in µm of the position's first ball when it was
    measured again. Positions whose first ball could not be measured again are left out."""
    found = ((position.balls[0].position, position.drift_mm) for position in measured.positions)
    lengths = {number: 1e3 * math.hypot(*drift.tolist()) for number, drift in found}
    return {number: length for number, length in lengths.items() if math.isfinite(length)}


def _renumbered(position: MeasuredPosition, start: int) -> MeasuredPosition:
    def shifted(ball: MeasuredBall) -> MeasuredBall:
        return replace(ball, position=start + ball.position)

    again = None if position.again is None else shifted(position.again)
    return replace(position, balls=tuple(shifted(ball) for ball in position.balls), again=again)
