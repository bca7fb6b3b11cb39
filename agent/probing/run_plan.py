"""All positions of a run, station by station: predict, measure, learn where the artefact really stands."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from agent.execution.steps import (
    CheckPermissions,
    CheckProbe,
    Plan,
    ReadPosition,
    ReadTemperatures,
    Record,
)
from agent.probing.paths.shortest_path import create_path_planner
from agent.probing.position import MeasuredPosition, PositionRules, PositionTask, measure_position
from agent.probing.station_change import change_station
from twin.artefact.mount_pose_estimate import MountPoseEstimate
from twin.artefact.position_set import Position
from twin.collision.measuring_layout import MeasuringLayout
from twin.design.procedure import MIN_BALLS


@dataclass(frozen=True)
class MeasuringOrder:
    """What is to be measured: `prefix` begins every key; positions in order, stations contiguous.

    `standing_at` is the station where the artefact stands when the plan begins; None when nobody knows, and where every
    station has its own and all mounts are parked.
    """

    prefix: str
    positions: tuple[Position, ...]
    standing_at: int | None


@dataclass(frozen=True)
class MeasuredPositions:
    """`positions[i]` belongs to index `indices[i]` of the order; left-out positions have none."""

    positions: tuple[MeasuredPosition, ...]
    left_out: tuple[str, ...]
    unreachable_balls: int
    standing_at: int | None
    standings: Mapping[int, MountPoseEstimate]

    @property
    def touches(self) -> int:
        return sum(p.touches for p in self.positions)

    @property
    def lost(self) -> int:
        return sum(p.lost for p in self.positions)


def measure_positions(
    order: MeasuringOrder,
    layout: MeasuringLayout,
    rules: PositionRules,
    known: Mapping[int, MountPoseEstimate] | None = None,
) -> Plan[MeasuredPositions]:
    """Measure every position of `order`. `known`: how the mount was found to stand earlier in this run."""
    yield CheckPermissions(f"{order.prefix}/permissions")
    yield CheckProbe(f"{order.prefix}/probe")
    yield ReadTemperatures(f"{order.prefix}/temperatures")
    here = np.array((yield ReadPosition(f"{order.prefix}/here")))
    standings: dict[int, MountPoseEstimate] = dict(known or {})
    stands_at = order.standing_at
    done: list[MeasuredPosition] = []
    left_out: list[str] = []
    unreachable = 0
    pilot = create_path_planner(rules.course, rules.probing, layout)
    inside = ""
    for index, position in enumerate(order.positions):
        if position.station != stands_at:
            if inside:
                yield from pilot.leave(inside, done[-1].balls[0].found.centre_mm)
                inside = ""
            here = yield from change_station(
                order.prefix, rules.change, rules.course, here, leaving=stands_at, to=position.station, index=index
            )
            stands_at = position.station
            if rules.change.moves_artefact:
                standings.pop(position.station, None)
        standing = standings.get(position.station, MountPoseEstimate.nominal())
        nominal = layout.nominal(position)
        predicted = standing.transform(nominal)
        mask = layout.reachable(position, predicted)
        unreachable += int(mask.size - mask.sum())
        key = f"{order.prefix}/{position_key(position)}"
        if mask.sum() < MIN_BALLS:
            left_out.append(position_key(position))
            yield Record(f"{key}/left-out", "event", {"reachable_balls": int(mask.sum())})
            continue
        task = PositionTask(
            key=key,
            index=index,
            station=position.station,
            azimuth_deg=position.azimuth_deg,
            elevation_deg=position.elevation_deg,
            predicted_mm=predicted,
            reachable=mask,
            found=len(standing.expected) > 0,
        )
        before = [ball.conditions for ball in done[-1].balls] if done else []
        measured = yield from measure_position(task, here, rules, before, pilot)
        standings[position.station] = standing.with_found_balls(nominal[measured.ball_numbers], measured.centres_mm)
        here = np.array((yield ReadPosition(f"{key}/here")))
        done.append(measured)
        inside = key
    if inside:
        yield from pilot.leave(inside, done[-1].balls[0].found.centre_mm)
    return MeasuredPositions(tuple(done), tuple(left_out), unreachable, stands_at, standings)


def position_key(position: Position) -> str:
    """``station-1/az090-el-45``."""
    return f"station-{position.station}/az{position.azimuth_deg:g}-el{position.elevation_deg:g}"


def by_station(positions: Sequence[Position], stations: Sequence[int]) -> tuple[Position, ...]:
    """Positions in the order of `stations`, their own order kept within each."""
    return tuple(p for station in stations for p in positions if p.station == station)
