"""Measurement of all positions of a run, station by station. For each position, the ball centres are predicted, the
balls are measured, and the estimated pose of the mount is updated."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from agent.errors import MeasurementFault, PlacementLost
from agent.execution.steps import (
    CheckPermissions,
    CheckProbe,
    MoveTo,
    Plan,
    ReadPosition,
    ReadTemperatures,
    Record,
    known,
)
from agent.probing.hand_placement import HandPlacement, PlacementFault, PlacementRefusal, PlacementTask, place_artefact
from agent.probing.paths.raised_path import RaisedPathPlanner
from agent.probing.paths.shortest_path import create_path_planner
from agent.probing.position import MeasuredPosition, PositionRules, PositionTask, measure_position
from agent.probing.station_change import change_station
from agent.probing.touch import point
from agent.thermal.readings import Conditions
from twin.artefact.artefact import Artefact
from twin.artefact.mount_pose_estimate import MountPoseEstimate
from twin.artefact.position_set import CHECKABLE_BALLS, MIN_BALLS, Position
from twin.collision.locating_balls import top_mm
from twin.collision.measuring_layout import MeasuringLayout
from twin.identification.checks.measured_shape import reversed_fit_mm
from twin.units import UM_PER_MM

MEASURED, VERIFIED = "measured", "verified"
"""Keys of the conclusions that hold the measurements of a run: those for its estimate, and those that verify its new
table."""


@dataclass(frozen=True)
class MeasuringOrder:
    """Positions in the order in which they are measured. The positions of one station follow one another. The key of
    every step begins with `prefix`.

    `standing_at` is the artefact's station at the start of the plan. It is None if the station is not known, or if
    every station has an artefact of its own and all mounts are parked. `placed` is the position in which an artefact
    that is placed by hand stands; it is None if it must be placed first. The first position has the number
    `first_number`.
    """

    prefix: str
    positions: tuple[Position, ...]
    standing_at: int | None
    placed: Position | None = None
    first_number: int = 0


@dataclass(frozen=True)
class MeasuredPositions:
    """Measured positions of a plan.

    `left_out` holds the keys of the positions that were not measured because too few balls are within reach.
    `standing_at` is the station of the artefact at the end. `mount_poses` maps each station to the estimated pose of
    its mount. `placed` is the position in which an artefact that is placed by hand stands at the end.
    """

    positions: tuple[MeasuredPosition, ...]
    left_out: tuple[str, ...]
    unreachable_balls: int
    standing_at: int | None
    mount_poses: Mapping[int, MountPoseEstimate]
    placed: Position | None = None

    @property
    def touches(self) -> int:
        return sum(p.touches for p in self.positions)

    @property
    def lost(self) -> int:
        return sum(p.lost for p in self.positions)

    @property
    def last_conditions(self) -> tuple[Conditions, ...]:
        """Temperature readings of the last position; empty if none was measured."""
        return self.positions[-1].conditions if self.positions else ()

    @property
    def uncheckable(self) -> int:
        """Number of positions with so few measured balls that a wrong one cannot be told from the others."""
        return sum(len(p.balls) < CHECKABLE_BALLS for p in self.positions)


def measure_positions(
    order: MeasuringOrder,
    layout: MeasuringLayout,
    rules: PositionRules,
    known: Mapping[int, MountPoseEstimate] | None = None,
    before: Sequence[Conditions] = (),
) -> Plan[MeasuredPositions]:
    """Measure every position of `order` that has enough balls within reach. `known` maps stations to the poses of the
    mount that were estimated earlier in the run, and `before` holds the temperature readings of the position that was
    measured last in the run."""
    yield CheckPermissions(f"{order.prefix}/permissions")
    yield CheckProbe(f"{order.prefix}/probe")
    yield ReadTemperatures(f"{order.prefix}/temperatures")
    if rules.placement is not None:
        return (yield from _measure_placed(order, layout, rules, rules.placement, before))
    here = np.array((yield ReadPosition(f"{order.prefix}/here")))
    mount_poses: dict[int, MountPoseEstimate] = dict(known or {})
    standing_at = order.standing_at
    measured_positions: list[MeasuredPosition] = []
    left_out: list[str] = []
    unreachable = 0
    planner = create_path_planner(rules.retreat, rules.probing, layout)
    entered_key = ""
    for index, position in enumerate(order.positions, start=order.first_number):
        if position.station != standing_at:
            if entered_key:
                yield from planner.leave(entered_key, measured_positions[-1].last_mm)
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
        unreachable += layout.asked_balls(position) - int(mask.sum())
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
        measured = yield from measure_position(task, here, rules, before, planner)
        _refuse_reversed(key, measured, layout.artefact_at(position.station))
        mount_poses[position.station] = mount_pose.with_found_balls(nominal[measured.ball_numbers], measured.centres_mm)
        here = np.array((yield ReadPosition(f"{key}/here")))
        measured_positions.append(measured)
        before = measured.conditions
        entered_key = key
    if entered_key:
        yield from planner.leave(entered_key, measured_positions[-1].last_mm)
    return MeasuredPositions(tuple(measured_positions), tuple(left_out), unreachable, standing_at, mount_poses)


def _measure_placed(
    order: MeasuringOrder,
    layout: MeasuringLayout,
    rules: PositionRules,
    placement: HandPlacement,
    before: Sequence[Conditions],
) -> Plan[MeasuredPositions]:
    """Measure the positions of an artefact that is placed by hand in each of them.

    If the artefact has to be placed again within a position, because it was moved while the run was interrupted, the
    position is measured anew and gets the next number.
    """
    placed, number = order.placed, 0
    measured_positions: list[MeasuredPosition] = []
    left_out: list[str] = []
    unreachable = 0
    for position in order.positions:
        name = position_key(position)
        mask = layout.reachable(position, layout.nominal(position))
        unreachable += layout.asked_balls(position) - int(mask.sum())
        if mask.sum() < MIN_BALLS:
            left_out.append(name)
            yield Record(f"{order.prefix}/{name}/left-out", "event", {"reachable_balls": int(mask.sum())})
            continue
        measuring = _PlacedMeasurement(f"{order.prefix}/{name}", number, position, layout, rules, placement)
        measured = yield from measuring.measure(before, standing=placed == position)
        number, placed = measuring.number + 1, position
        measured_positions.append(measured)
        before = measured.conditions
    standing_at = order.standing_at if placed is None else placed.station
    return MeasuredPositions(tuple(measured_positions), tuple(left_out), unreachable, standing_at, {}, placed)


@dataclass
class _PlacedMeasurement:
    """Measurement of one position of an artefact that is placed by hand. `number` is the number of the position."""

    key: str
    number: int
    position: Position
    layout: MeasuringLayout
    rules: PositionRules
    placement: HandPlacement

    def measure(self, before: Sequence[Conditions], *, standing: bool) -> Plan[MeasuredPosition]:
        """Have the artefact placed, locate it and measure it; leave the probe beside the station.

        If `standing` is True, the artefact may stand in the position already. Raises MeasurementFault if it has to be
        placed again too often.
        """
        lost: PlacementRefusal | None = None
        for attempt in range(self.placement.attempts):
            key = self.key if attempt == 0 else f"{self.key}/again-{attempt}"
            try:
                measured = yield from self._attempt(key, before, standing=standing or attempt > 0, lost=lost)
            except PlacementLost as error:
                yield Record(f"{key}/placement-lost", "event", {"reason": error.message, "position": self.number})
                lost = PlacementRefusal(PlacementFault.LOST, error.message)
                self.number += 1
                continue
            yield from self._leave(key)
            return measured
        raise MeasurementFault(
            f"the artefact was moved {self.placement.attempts} times while it was being measured",
            hint="leave it standing until the next request",
            step=self.key,
        )

    def _attempt(
        self, key: str, before: Sequence[Conditions], *, standing: bool, lost: PlacementRefusal | None
    ) -> Plan[MeasuredPosition]:
        position, layout, rules = self.position, self.layout, self.rules
        task = PlacementTask.of(key, position, layout, rules.retreat, rules.probing, self.placement)
        located = yield from place_artefact(task, standing=standing, lost=lost)
        mask = layout.reachable(position, located)
        planner = placed_planner(position, layout, rules)
        measuring = PositionTask(
            key=key,
            index=self.number,
            station=position.station,
            azimuth_deg=position.azimuth_deg,
            elevation_deg=position.elevation_deg,
            predicted_mm=located,
            reachable=mask,
        )
        here = np.array((yield ReadPosition(f"{key}/here")))
        measured = yield from measure_position(measuring, here, rules, before, planner)
        _refuse_reversed(key, measured, layout.artefact_at(position.station))
        return measured

    def _leave(self, key: str) -> Plan[None]:
        """Move the probe to the retreat plane. The position is complete: if the artefact is gone, nothing is lost."""
        try:
            here = np.array((yield ReadPosition(f"{key}/end")))
            yield MoveTo(f"{key}/leave", point(self.rules.retreat.at_retreat_plane(here)))
        except PlacementLost as error:
            yield Record(f"{key}/moved-afterwards", "event", {"reason": error.message})


def _refuse_reversed(key: str, measured: MeasuredPosition, artefact: Artefact) -> None:
    """Raise MeasurementFault if the balls of a position fit the artefact only from the other end: nothing that is
    measured further would be of use."""
    fits_mm = reversed_fit_mm(artefact, measured.ball_numbers, measured.centres_mm)
    if fits_mm is not None:
        as_numbered, from_other_end = (UM_PER_MM * fit for fit in fits_mm)
        raise MeasurementFault(
            f"the artefact is mounted end for end: its balls fit the certificate to {as_numbered:.1f} µm as numbered, "
            f"and to {from_other_end:.1f} µm if they are numbered from the other end",
            hint="turn the artefact round, or list its balls from the other end in the artefact file",
            step=key,
        )


def placed_planner(position: Position, layout: MeasuringLayout, rules: PositionRules) -> RaisedPathPlanner:
    """Return the path planner for an artefact that was placed by hand in `position`."""
    return RaisedPathPlanner(rules.retreat, rules.probing, _top_axis_mm(position, layout))


def gap_above_mm(position: Position, layout: MeasuringLayout, rules: PositionRules) -> float:
    """Return the distance in mm from the artefact in `position` to the tip that crosses above it in the retreat plane;
    negative if the artefact reaches higher."""
    up = float(-layout.frame.stylus_axis[layout.frame.axis])
    return up * (rules.retreat.retreat_mm - _top_axis_mm(position, layout)) - rules.probing.tip_radius_mm


def _top_axis_mm(position: Position, layout: MeasuringLayout) -> float:
    up, axis = -layout.frame.stylus_axis, layout.frame.axis
    return float(up[axis]) * top_mm(layout, position) - float(layout.tool_offset_mm[axis])


def note_measured(role: str, measured: MeasuredPositions) -> Plan[None]:
    """Make `measured` known to whoever observes the run, under the key `role`, `MEASURED` or `VERIFIED`."""
    yield known(role, measured)


def positions_in(measured: MeasuredPositions) -> tuple[Position, ...]:
    """Return the positions that `measured` contains, in the order measured and without a choice of their balls."""
    return tuple(one.position for one in measured.positions)


def position_key(position: Position) -> str:
    """Return the key of a position, such as ``station-1/az90-el-45`` for station 1, azimuth 90° and elevation −45°."""
    return f"station-{position.station}/az{position.azimuth_deg:g}-el{position.elevation_deg:g}"


def is_within_position(key: str) -> bool:
    """Return True if the step with this key belongs to the measurement of one position, see `position_key`."""
    return "/station-" in key


def by_station(positions: Sequence[Position], stations: Sequence[int]) -> tuple[Position, ...]:
    """Return the positions sorted by station, in the order of `stations`. Positions at one station keep their given
    order."""
    return tuple(p for station in stations for p in positions if p.station == station)
