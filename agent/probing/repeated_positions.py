"""The loop over a run is closed: where the machine has changed, the first positions are measured again at the end.

Stations are visited one after the other, so what changes with time looks as if it changed along the travel: a scale
that grows from station to station may as well be one that is not straight. Only a place that is measured twice, early
and late, tells the two apart. A rigid motion of the bar since then is in its new pose.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace

from agent.execution.steps import Plan, Record
from agent.probing.position import MeasuredBall, MeasuredPosition, PositionRules
from agent.probing.run_plan import MeasuredPositions, MeasuringOrder, measure_positions
from agent.probing.temperature_readings import Conditions
from twin.artefact.position_set import Position
from twin.collision.measuring_layout import MeasuringLayout

REPEAT_PREFIX = "close"


@dataclass(frozen=True)
class RepeatRules:
    """`change_k` of the machine from which on the loop is closed, with the first `count` of the positions `of`;
    `declared_k` where no thermometer is on the machine."""

    change_k: float
    declared_k: float
    count: int
    of: Collection[Position]


def measure_with_repeats(
    order: MeasuringOrder, layout: MeasuringLayout, rules: PositionRules, closing: RepeatRules
) -> Plan[MeasuredPositions]:
    """`measure_positions`, and the first ones of them again where the machine has changed in between."""
    measured = yield from measure_positions(order, layout, rules)
    change_k = machine_change_k([ball.conditions for ball in measured_balls(measured)], closing.declared_k)
    first = _first(measured, closing)
    if not first or change_k < closing.change_k:
        return measured
    note = f"the machine has changed by {change_k:.2f} K: positions of the first station are measured again"
    yield Record(f"{REPEAT_PREFIX}/machine", "event", {"note": note})
    again = MeasuringOrder(REPEAT_PREFIX, first, measured.standing_at)
    return join_measured(measured, (yield from measure_positions(again, layout, rules, measured.mount_poses)))


def machine_change_k(conditions: Collection[Conditions], declared_k: float) -> float:
    """Range of what the machine's thermometers told; `declared_k` where there are none."""
    told = [one.machine_c for one in conditions if one.machine_c is not None]
    return max(told) - min(told) if told else declared_k


def measured_balls(measured: MeasuredPositions) -> list[MeasuredBall]:
    return [ball for position in measured.positions for ball in position.balls]


def join_measured(one: MeasuredPositions, other: MeasuredPositions) -> MeasuredPositions:
    """As if all had been one order; the positions of the second are numbered on."""
    start = max((ball.position for ball in measured_balls(one)), default=-1) + 1
    return MeasuredPositions(
        positions=(*one.positions, *(_renumbered(position, start) for position in other.positions)),
        left_out=(*one.left_out, *other.left_out),
        unreachable_balls=one.unreachable_balls + other.unreachable_balls,
        standing_at=other.standing_at,
        mount_poses=other.mount_poses,
    )


def drifts_um(measured: MeasuredPositions) -> Mapping[int, float]:
    """By the number of each position: how far its first ball had moved at its end, where it was found again."""
    found = ((position.balls[0].position, position.drift_mm) for position in measured.positions)
    lengths = {number: 1e3 * math.hypot(*drift.tolist()) for number, drift in found}
    return {number: length for number, length in lengths.items() if math.isfinite(length)}


def _renumbered(position: MeasuredPosition, start: int) -> MeasuredPosition:
    def shifted(ball: MeasuredBall) -> MeasuredBall:
        return replace(ball, position=start + ball.position)

    again = None if position.again is None else shifted(position.again)
    return replace(position, balls=tuple(shifted(ball) for ball in position.balls), again=again)


def _first(measured: MeasuredPositions, closing: RepeatRules) -> tuple[Position, ...]:
    """The first of the set that were measured, all at one station."""
    first = [position.balls[0] for position in measured.positions]
    places = [Position(ball.station, ball.azimuth_deg, ball.elevation_deg) for ball in first]
    wanted = [place for place in places if place in closing.of]
    return tuple(place for place in wanted if place.station == wanted[0].station)[: closing.count]
