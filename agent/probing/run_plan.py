"""Measurement of all positions of a run, station by station. For each position, the ball centres are predicted, the
balls are measured, and the estimated pose of the mount (its small deviation from the nominal place) is updated."""

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
    """Positions in the order in which they are measured. The positions of one station follow one another. The key of
    every step begins with `prefix`.

    `standing_at` is the artefact's station at the start of the plan. It is None if the station is not known, or if
    every station has an artefact of its own and all mounts are parked.
    """

    prefix: str
    positions: tuple[Position, ...]
    standing_at: int | None


@dataclass(frozen=True)
class MeasuredPositions:
    """Measured positions of a plan.

    `left_out` holds the keys of the positions that were not measured because too few balls are within reach.
    `standing_at` is the station of the artefact at the end. `mount_poses` maps each station to the estimated pose of
    its mount (the small deviation from the nominal place).
    """

    positions: tuple[MeasuredPosition, ...]
    left_out: tuple[str, ...]
    unreachable_balls: int
    standing_at: int | None
    mount_poses: Mapping[int, MountPoseEstimate]

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
    """Measure every position of `order` that has enough balls within reach. `known` maps stations to the poses of the
    mount that were estimated earlier in the run."""
    yield CheckPermissions(f"{order.prefix}/permissions")
    yield CheckProbe(f"{order.prefix}/probe")
    yield ReadTemperatures(f"{order.prefix}/temperatures")
    here = np.array((yield ReadPosition(f"{order.prefix}/here")))
    mount_poses: dict[int, MountPoseEstimate] = dict(known or {})
    standing_at = order.standing_at
    measured_positions: list[MeasuredPosition] = []
    left_out: list[str] = []
    unreachable = 0
    planner = create_path_planner(rules.retreat, rules.probing, layout)
    entered_key = ""
    for index, position in enumerate(order.positions):
        if position.station != standing_at:
            if entered_key:
                yield from planner.leave(entered_key, measured_positions[-1].balls[0].found.centre_mm)
                entered_key = ""
            here = yield from change_station(
                order.prefix, rules.change, rules.retreat, here, leaving=standing_at, to=position.station, index=index
            )
            standing_at = position.station
            if rules.change.moves_artefact:
                mount_poses.pop(position.station, None)
        mount_pose = mount_poses.get(position.station, MountPoseEstimate.nominal())
        nominal = layout.nominal(position)
        predicted = mount_pose.transform(nominal)
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
            located=len(mount_pose.expected) > 0,
        )
        before = [ball.conditions for ball in measured_positions[-1].balls] if measured_positions else []
        measured = yield from measure_position(task, here, rules, before, planner)
        mount_poses[position.station] = mount_pose.with_found_balls(nominal[measured.ball_numbers], measured.centres_mm)
        here = np.array((yield ReadPosition(f"{key}/here")))
        measured_positions.append(measured)
        entered_key = key
    if entered_key:
        yield from planner.leave(entered_key, measured_positions[-1].balls[0].found.centre_mm)
    return MeasuredPositions(tuple(measured_positions), tuple(left_out), unreachable, standing_at, mount_poses)


def position_key(position: Position) -> str:
    """Return the key of a position, such as ``station-1/az90-el-45`` for station 1, azimuth 90° and elevation −45°."""
    return f"station-{position.station}/az{position.azimuth_deg:g}-el{position.elevation_deg:g}"


def by_station(positions: Sequence[Position], stations: Sequence[int]) -> tuple[Position, ...]:
    """Return the positions sorted by station, in the order of `stations`. Positions at one station keep their given
    order."""
    return tuple(p for station in stations for p in positions if p.station == station)
