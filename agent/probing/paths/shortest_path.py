"""Path planner that moves the tip on the fastest path that is proved free of collisions. If no path is proved free, the
tip moves on a plain path, by way of a plane that is always safe."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from agent.execution.steps import MoveTo, OrientTo, Plan, Point
from agent.probing.paths.approach_points import TipLocation
from agent.probing.paths.artefact_bodies import ArtefactPose
from agent.probing.paths.ball_order import shortest_sequence
from agent.probing.paths.free_paths import FreePathFinder, TurningPath
from agent.probing.paths.path_planner import MeasuringSequence, PlainPathPlanner, PlannedPosition
from agent.probing.paths.retreat import Retreat
from agent.probing.probing_parameters import ProbingParameters
from agent.probing.touch import PlannedTouch, TouchPath, before_ball, point
from twin.arrays import Array
from twin.artefact.pose_alignment import AlignmentBalls, choose_alignment_balls
from twin.artefact.position_set import Position
from twin.collision.geometry import Point as Corner
from twin.collision.measuring_layout import MeasuringLayout

PARK_OFFSETS_MM = (0.0, 150.0, -150.0, 300.0, -300.0)
"""Offsets of the park locations perpendicular to the stylus and to the station axis, in the order in which they are
tried: first no offset, then offsets to both sides of a part of the artefact that is in the path."""
_ORIGIN = (0.0, 0.0, 0.0)


@dataclass(eq=False)
class _CurrentPose:
    """Pose being measured. `nominal` (N, 3) has the axis positions of the balls according to the drawings. `centres`
    (N, 3) has the axis positions as known so far, with the uncertainty `uncertainty_mm`."""

    artefact_pose: ArtefactPose
    station: int
    nominal: Array
    centres: Array
    uncertainty_mm: float

    def deviation_mm(self, offset: Array, ball: int) -> float:
        """Return the distance in mm between the known centre of `ball` and its nominal location shifted by `offset`
        (3,)."""
        return math.dist(offset.tolist(), (self.centres[ball] - self.nominal[ball]).tolist())


@dataclass(frozen=True, eq=False)
class _TipState:
    """Tip location at a ball. `offset` (3,) is the assumed displacement of the ball from its nominal location."""

    location: TipLocation
    offset: Array


class ShortestPathPlanner:
    """Path planner that takes the fastest collision-free paths and keeps track of the tip's location. Equal measured
    results always give equal paths."""

    def __init__(self, finder: FreePathFinder, retreat: Retreat, probing: ProbingParameters) -> None:
        self._finder = finder
        self._retreat = retreat
        self._probing = probing
        self._plain = PlainPathPlanner(retreat, probing)
        self._pose: _CurrentPose | None = None
        self._tip: _TipState | None = None
        self._entry_path: tuple[Corner, ...] | None = None
        self._here: Array = np.zeros(3)

    def assume_measured(self, station: int) -> Array:
        """Assume that ball 0 at `station` has just been measured with azimuth and elevation of the mount at 0; return
        the axis positions (3,) of the tip."""
        artefact_pose = self._finder.pose_at(station, 0.0, 0.0)
        nominal = self._finder.ball_axes(artefact_pose, station)
        location = TipLocation(0, point(self._probing.directions[-1]), self._probing.contact_mm, touching=True)
        self._pose = _CurrentPose(artefact_pose, station, nominal, nominal, self._finder.rules.aligned_uncertainty_mm)
        self._set_tip(
            _TipState(location, np.zeros(3)),
            self._finder.axes_at(station, self._finder.tip_at(artefact_pose, location)),
        )
        return self._here

    def sequence(self, task: PlannedPosition) -> MeasuringSequence:
        artefact_pose = self._artefact_pose(task)
        chosen = self._alignment_balls(task)
        first, last = self._ends(task, artefact_pose)
        before = last if chosen.third is None else chosen.third
        rest = [ball for ball in task.balls if ball != last or last == before]
        others = shortest_sequence(self._finder, artefact_pose, self._probing, rest, before, first)
        return MeasuringSequence(first, last, chosen.third, others)

    def turn(self, task: PlannedPosition, here: Array) -> Plan[None]:
        artefact_pose = self._artefact_pose(task)
        nominal = self._finder.ball_axes(artefact_pose, task.station)
        first = self._ends(task, artefact_pose)[0]
        path = self._turning_path(task, artefact_pose, first)
        too_far = float(np.abs(task.predicted_mm - nominal).max()) > self._finder.rules.unaligned_uncertainty_mm
        if path is None or too_far or self._tip is None:
            free = here if self._tip is None else (yield from self._withdraw(f"{task.key}/from-before"))
            yield from self._plain.turn(task, free)
            self._entry_path = None
        else:
            offset = self._tip.offset
            for number, corner in enumerate(path.exit_path):
                yield MoveTo(f"{task.key}/out-{number}", point(self._finder.axes_at(task.station, corner) + offset))
            self._here = self._finder.axes_at(task.station, path.waiting_point)
            yield MoveTo(f"{task.key}/wait", point(self._here))
            yield OrientTo(f"{task.key}/orient", task.station, task.azimuth_deg, task.elevation_deg)
            self._entry_path = path.entry_path
        self._pose = _CurrentPose(
            artefact_pose, task.station, nominal, task.predicted_mm, self._finder.rules.unaligned_uncertainty_mm
        )
        self._tip = None

    def enter(self, task: PlannedPosition, ball: int) -> Plan[None]:
        if self._entry_path is None:
            self._here = self._retreat.at_retreat_plane(task.predicted_mm[ball])
            yield from self._plain.enter(task, ball)

    def align(self, centres_mm: Array) -> None:
        pose = self._known_pose
        pose.centres = centres_mm
        offset = centres_mm - pose.nominal
        # A rotation against the nominal pose shows as differing offsets of the balls; their range bounds its effect.
        pose.uncertainty_mm = self._finder.rules.aligned_uncertainty_mm + float(np.linalg.norm(np.ptp(offset, axis=0)))

    def to_ball(self, key: str, centre: Array) -> Plan[None]:
        yield from ()

    def from_ball(self, key: str, centre: Array) -> Plan[None]:
        yield from ()

    def touch_path(self, ball: int) -> TouchPath:
        return _BallTouchPath(self, ball)

    def leave(self, key: str, centre: Array) -> Plan[None]:
        """Move the tip to a park location beside the station of the artefact. The artefact does not reach this location
        in any pose.

        If no path to a park location is proved free, lift the tip off the ball's surface and withdraw it straight along
        the stylus. The stylus then moves only through space that it has already passed.
        """
        if self._tip is not None:
            yield from self._withdraw(key)
        self._tip = self._pose = self._entry_path = None

    def _withdraw(self, key: str) -> Plan[Array]:
        """Withdraw to the park location or straight along the stylus, see `leave`; return the axis positions (3,)
        reached."""
        path = self._exit_path()
        if path is None:
            free = yield from self._lift_off(key, self._here)
            corners, end = list[Array](), self._retreat.at_retreat_plane(free)
        else:
            corners, end = path
        for number, corner in enumerate(corners):
            yield MoveTo(f"{key}/away-{number}", point(corner))
        yield MoveTo(f"{key}/leave", point(end))
        return end

    def _lift_off(self, key: str, here: Array) -> Plan[Array]:
        """Lift the tip off if it is on a surface; return the axis positions (3,) from which it can be withdrawn
        freely."""
        tip = self._tip
        if tip is None or not tip.location.touching:
            return here
        out = self._probing.contact_mm + self._probing.narrow_search.approach_mm
        free = here - np.array(tip.location.direction) * (out - tip.location.out_mm)
        yield MoveTo(f"{key}/off", point(free))
        return np.asarray(free)

    def take_over(self, key: str, position: Position, ball: int, centre: Array) -> Plan[None]:
        """Start planning from the present place of the tip, which is in front of `ball`, in a plane perpendicular to
        the stylus. `centre` (3,) holds the axis positions at which the ball was found."""
        station = position.station
        artefact_pose = self._finder.pose_at(station, position.azimuth_deg, position.elevation_deg)
        nominal = self._finder.ball_axes(artefact_pose, station)
        offset = centre - nominal[ball]
        self._pose = _CurrentPose(
            artefact_pose, station, nominal, nominal + offset, self._finder.rules.unaligned_uncertainty_mm
        )
        out_mm = self._probing.contact_mm + self._probing.narrow_search.approach_mm
        location = TipLocation(ball, point(self._probing.directions[0]), out_mm)
        self._set_tip(_TipState(location, offset), centre - self._probing.directions[0] * out_mm)
        yield MoveTo(f"{key}/off-ball", point(self._here))

    def _exit_path(self) -> tuple[list[Array], Array] | None:
        """Return the corners of a path to a park location, and that location; None if no path is proved free."""
        finder, tip, pose = self._finder, self._tip, self._known_pose
        if tip is None or float(np.linalg.norm(tip.offset)) > finder.rules.unaligned_uncertainty_mm:
            return None
        location = finder.axes_at(pose.station, finder.tip_at(pose.artefact_pose, tip.location))
        for offset_mm in PARK_OFFSETS_MM:
            aside = location.copy()
            aside[self._retreat.side_axis] += offset_mm
            parked = self._inside(self._retreat.park_location(aside, pose.station))
            path = finder.path_to_point(
                pose.artefact_pose, tip.location, point(parked - finder.axes_at(pose.station, _ORIGIN))
            )
            if path is not None:
                corners = [finder.axes_at(pose.station, corner) + tip.offset for corner in path.corners]
                return [self._inside(corner) for corner in corners], parked
        return None

    def _inside(self, corner: Array) -> Array:
        """Return `corner` clipped to the travel of the axes.

        Park locations and the corners of paths to them lie at the end of the travel, and the artefact's offset may
        shift them beyond it. The clearance allows for that shift.
        """
        rules = self._finder.rules
        return np.asarray(np.clip(corner, rules.lower_mm, rules.upper_mm))

    # ------------------------------------------------------------------ at a ball

    def approach(self, key: str, ball: int, touch: PlannedTouch) -> Plan[None]:
        """Move the tip to the start of `touch`, the next touch of `ball`."""
        pose, tip = self._known_pose, self._tip
        location = TipLocation(ball, point(touch.direction), touch.out_mm)
        offset = touch.centre - pose.nominal[ball]
        corners = self._corners(location, offset, touch)
        feed = touch.search.guarded_feed_mm_per_s
        beside = tip is not None and tip.location.ball == ball
        if feed is not None and not beside:
            corners = [*corners, _slow_down_point(touch, corners[-1] if corners else self._here)]
        for number, target in enumerate(corners):
            yield MoveTo(f"{key}/via-{number}", point(target), feed if beside else None)
        yield MoveTo(f"{key}/start", point(touch.start), feed)
        self._set_tip(_TipState(location, offset), touch.start)

    def retract(self, key: str, ball: int, touch: PlannedTouch, latched_mm: Point | None) -> Plan[None]:
        """Leave the tip on the ball's surface if the contact was at the expected point, because the next path can start
        there. Otherwise, move the tip back to the start of the touch."""
        tip = self._tip
        assert tip is not None  # noqa: S101  `approach` came before
        if latched_mm is not None and touch.search == self._probing.narrow_search:
            deviation_mm = math.dist(latched_mm, touch.surface.tolist())
            if deviation_mm <= self._finder.rules.aligned_uncertainty_mm:
                location = TipLocation(ball, tip.location.direction, touch.contact_mm, touching=True)
                self._set_tip(_TipState(location, tip.offset), np.array(latched_mm))
                return
        yield MoveTo(f"{key}/back", point(touch.start))

    def _corners(self, location: TipLocation, offset: Array, touch: PlannedTouch) -> list[Array]:
        """Return the axis positions (3,) of each corner of the path to `location`."""
        pose, tip = self._known_pose, self._tip
        if tip is None:
            corners, self._entry_path = self._entry_path or (), None
            return [self._finder.axes_at(pose.station, corner) + offset for corner in corners]
        deviation = max(pose.deviation_mm(offset, location.ball), pose.deviation_mm(tip.offset, tip.location.ball))
        path = self._finder.path_between(
            pose.artefact_pose, tip.location, location, pose.uncertainty_mm + deviation, pose.station
        )
        if path is None or math.hypot(*offset.tolist()) > self._finder.rules.unaligned_uncertainty_mm:
            return self._plain_corners(tip, touch)
        first, last = (self._finder.tip_at(pose.artefact_pose, one) for one in (tip.location, location))
        return [
            self._finder.axes_at(pose.station, corner)
            + _interpolated(tip.offset, offset, _fraction_along(corner, first, last))
            for corner in path.corners
        ]

    def _plain_corners(self, tip: _TipState, touch: PlannedTouch) -> list[Array]:
        """Return the corners of a plain path. It leads by way of the plane in front of the ball if the tip is already
        at that ball, else by way of the retreat plane."""
        here = self._here
        beside = here - np.array(tip.location.direction) * (touch.out_mm - tip.location.out_mm)
        leaving = [beside] if tip.location.touching else []
        before = before_ball(touch, self._probing)
        # The tip counts as at this ball if it is within twice `out_mm` of the centre. In runs of plain paths alone (the
        # shipped cases of the case study, the mill and the router), a tip at the same ball was 0.80 to 1.36 times
        # `out_mm` away, farthest after a wide search, which begins farther out. A tip at another ball was at least 2.26
        # times `out_mm` away, nearest on the bar whose balls are 52 mm apart.
        if float(np.linalg.norm(here - touch.centre)) < 2.0 * touch.out_mm:
            # Project on the stylus axis: withdraw along it to the depth of `before`, and cross over in that plane.
            depth = before - touch.centre
            back = beside + self._probing.stylus_axis * float(
                (depth - (beside - touch.centre)) @ self._probing.stylus_axis
            )
            return [*leaving, back, before]
        return [*leaving, self._retreat.at_retreat_plane(beside), self._retreat.at_retreat_plane(before)]

    def _set_tip(self, tip: _TipState, here: Array) -> None:
        self._tip, self._here = tip, here

    # ------------------------------------------------------------------ between positions

    def _ends(self, task: PlannedPosition, artefact_pose: ArtefactPose) -> tuple[int, int]:
        """Return the two end balls; the first is the one that the tip reaches faster."""
        ends = self._alignment_balls(task).ends
        path = self._turning_path(task, artefact_pose, ends[0])
        if path is None or self._turning_path(task, artefact_pose, ends[1], faster_than_s=path.seconds) is None:
            return ends
        return ends[::-1]

    def _alignment_balls(self, task: PlannedPosition) -> AlignmentBalls:
        return choose_alignment_balls(task.predicted_mm, task.balls)

    def _turning_path(
        self, task: PlannedPosition, artefact_pose: ArtefactPose, ball: int, faster_than_s: float = math.inf
    ) -> TurningPath | None:
        tip, pose = self._tip, self._pose
        if tip is None or pose is None or pose.station != task.station or self._moved_too_far(tip):
            return None
        pole = TipLocation(
            ball, point(self._probing.directions[0]), self._probing.contact_mm + self._probing.wide_search.approach_mm
        )
        return self._finder.turning_path(
            pose.artefact_pose, tip.location, artefact_pose, pole, task.station, faster_than_s
        )

    def _moved_too_far(self, tip: _TipState) -> bool:
        """Return whether the ball's offset exceeds the uncertainty for which the paths were planned."""
        return float(np.linalg.norm(tip.offset)) > self._finder.rules.unaligned_uncertainty_mm

    def _artefact_pose(self, task: PlannedPosition) -> ArtefactPose:
        return self._finder.pose_at(task.station, task.azimuth_deg, task.elevation_deg)

    @property
    def _known_pose(self) -> _CurrentPose:
        assert self._pose is not None  # noqa: S101  `turn` came before
        return self._pose


@dataclass(frozen=True, eq=False)
class _BallTouchPath:
    """Paths to and from the touches of one ball."""

    planner: ShortestPathPlanner
    ball: int

    def approach(self, key: str, touch: PlannedTouch) -> Plan[None]:
        yield from self.planner.approach(key, self.ball, touch)

    def retract(self, key: str, touch: PlannedTouch, latched_mm: Point | None) -> Plan[None]:
        yield from self.planner.retract(key, self.ball, touch, latched_mm)


def create_path_planner(
    retreat: Retreat, probing: ProbingParameters, layout: MeasuringLayout
) -> PlainPathPlanner | ShortestPathPlanner:
    """Return a ShortestPathPlanner if `retreat` has rules for collision-free paths, otherwise a PlainPathPlanner."""
    if retreat.path_rules is None:
        return PlainPathPlanner(retreat, probing)
    return ShortestPathPlanner(retreat.path_rules.finder_for(layout), retreat, probing)


def _slow_down_point(touch: PlannedTouch, coming_from: Array) -> Array:
    """Return the point on the last leg from which the tip moves slowly, because it may meet the ball from there on."""
    path = coming_from - touch.start
    length = float(np.linalg.norm(path))
    return np.asarray(touch.start + path * min(1.0, 2.0 * touch.search.approach_mm / max(length, 1e-9)))


def _fraction_along(corner: Corner, first: Corner, last: Corner) -> float:
    """Return the projection of `corner` on the line from `first` (0) to `last` (1), clipped to 0 … 1."""
    # t = (c − a)·(b − a) / |b − a|², limited to the segment from a to b.
    x, y, z = last[0] - first[0], last[1] - first[1], last[2] - first[2]
    along = (corner[0] - first[0]) * x + (corner[1] - first[1]) * y + (corner[2] - first[2]) * z
    return min(max(along / max(x * x + y * y + z * z, 1e-12), 0.0), 1.0)


def _interpolated(first: Array, last: Array, share: float) -> Array:
    return np.asarray((1.0 - share) * first + share * last)
