"""The tip on the fastest ways that are proved to be free, and on plain ones where none is."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from agent.execution.steps import MoveTo, OrientTo, Plan, Point
from agent.probing.paths.approach_points import TipLocation
from agent.probing.paths.ball_order import measuring_sequence
from agent.probing.paths.free_paths import ArtefactPose, FreePathFinder, TurningPath
from agent.probing.paths.path_planner import PlainPathPlanner, PlannedPosition
from agent.probing.paths.retreat import Retreat
from agent.probing.probing_parameters import ProbingParameters
from agent.probing.touch import PlannedTouch, TouchPath, before_ball, point
from twin.arrays import Array
from twin.artefact.position_set import Position
from twin.collision.geometry import Point as Corner
from twin.collision.measuring_layout import MeasuringLayout

PARK_OFFSETS_MM = ((0.0, 0.0, 0.0), *((0.0, 0.0, height) for height in (150.0, -150.0, 300.0, -300.0)))
"""Other parking places, over and under an end of the bar that reaches into the way."""
_ORIGIN = (0.0, 0.0, 0.0)


@dataclass(eq=False)
class _CurrentPose:
    """The pose that is being measured. `nominal` and `centres` (N, 3): axis positions of the balls by the drawings and
    as known; `uncertain_mm`: by so much the latter may be off."""

    stand: ArtefactPose
    station: int
    nominal: Array
    centres: Array
    uncertain_mm: float

    def mistaken_mm(self, off: Array, ball: int) -> float:
        """How far a ball that was thought `off` (3,) its drawing's place is from where it is known to be."""
        return math.dist(off.tolist(), (self.centres[ball] - self.nominal[ball]).tolist())


@dataclass(frozen=True, eq=False)
class _TipState:
    """Where the tip is: at a spot of a ball that was thought `off` (3,) its drawing's place."""

    spot: TipLocation
    off: Array


class ShortestPathPlanner:
    """Remembers where the tip is; a plan that is rebuilt from the same results makes the same one again."""

    def __init__(self, traffic: FreePathFinder, course: Retreat, probing: ProbingParameters) -> None:
        self._traffic = traffic
        self._course = course
        self._probing = probing
        self._plain = PlainPathPlanner(course, probing)
        self._pose: _CurrentPose | None = None
        self._there: _TipState | None = None
        self._way_in: tuple[Corner, ...] | None = None
        self._here: Array = np.zeros(3)

    def suppose(self, station: int) -> Array:
        """As if ball 0 had just been measured with the mount at zero; (3,) where the axes stand then."""
        stand = self._traffic.standing(station, 0.0, 0.0)
        nominal = self._traffic.nominal(stand, station)
        spot = TipLocation(0, point(self._probing.directions[-1]), self._probing.contact_mm, touching=True)
        self._pose = _CurrentPose(stand, station, nominal, nominal, self._traffic.roads.known_mm)
        self._at(_TipState(spot, np.zeros(3)), self._traffic.axes_at(station, self._traffic.at(stand, spot)))
        return self._here

    def sequence(self, task: PlannedPosition) -> tuple[int, list[int], int]:
        stand = self._stand(task)
        first, last = self._ends(task, stand)
        return first, measuring_sequence(self._traffic, stand, self._probing, task.balls, first, last), last

    def turn(self, task: PlannedPosition, here: Array) -> Plan[None]:
        stand = self._stand(task)
        nominal = self._traffic.nominal(stand, task.station)
        first = self._ends(task, stand)[0]
        way = self._turning(task, stand, first)
        far = float(np.abs(task.predicted_mm - nominal).max()) > self._traffic.roads.unknown_mm
        if way is None or far or self._there is None:
            free = here if self._there is None else (yield from self._out(f"{task.key}/from-before"))
            yield from self._plain.turn(task, free)
            self._way_in = None
        else:
            off = self._there.off
            for number, corner in enumerate(way.out):
                yield MoveTo(f"{task.key}/out-{number}", point(self._traffic.axes_at(task.station, corner) + off))
            self._here = self._traffic.axes_at(task.station, way.waiting)
            yield MoveTo(f"{task.key}/wait", point(self._here))
            yield OrientTo(f"{task.key}/orient", task.station, task.azimuth_deg, task.elevation_deg)
            self._way_in = way.into
        self._pose = _CurrentPose(stand, task.station, nominal, task.predicted_mm, self._traffic.roads.unknown_mm)
        self._there = None

    def enter(self, task: PlannedPosition, ball: int) -> Plan[None]:
        if self._way_in is None:
            self._here = self._course.retreated(task.predicted_mm[ball])
            yield from self._plain.enter(task, ball)

    def align(self, centres_mm: Array) -> None:
        pose = self._known_pose
        pose.centres = centres_mm
        off = centres_mm - pose.nominal
        # A turned artefact stands differently beside a probe that does not turn, by no more than this.
        pose.uncertain_mm = self._traffic.roads.known_mm + float(np.linalg.norm(np.ptp(off, axis=0)))

    def to_ball(self, key: str, centre: Array) -> Plan[None]:
        yield from ()

    def from_ball(self, key: str, centre: Array) -> Plan[None]:
        yield from ()

    def way_at(self, ball: int) -> TouchPath:
        return _BallTouchPath(self, ball)

    def leave(self, key: str, centre: Array) -> Plan[None]:
        """To the parking place beside the station, where no bar reaches however it stands; where no way there is proved
        to be free, off the surface and straight back: nothing but the tip has been anywhere new."""
        if self._there is not None:
            yield from self._out(key)
        self._there = self._pose = self._way_in = None

    def _out(self, key: str) -> Plan[Array]:
        """As `leave` says; where the axes stand then."""
        way = self._way_out()
        if way is None:
            free = yield from self._off(key, self._here)
            corners, end = list[Array](), self._course.retreated(free)
        else:
            corners, end = way
        for number, corner in enumerate(corners):
            yield MoveTo(f"{key}/away-{number}", point(corner))
        yield MoveTo(f"{key}/leave", point(end))
        return end

    def _off(self, key: str, here: Array) -> Plan[Array]:
        """Where the tip is clear of the surface that it may still rest on; drawn back from there it presses nothing."""
        there = self._there
        if there is None or not there.spot.touching:
            return here
        out = self._probing.contact_mm + self._probing.narrow.approach_mm
        free = here - np.array(there.spot.direction) * (out - there.spot.out_mm)
        yield MoveTo(f"{key}/off", point(free))
        return np.asarray(free)

    def beside(self, key: str, position: Position, ball: int, centre: Array) -> Plan[None]:
        """Take over before a `ball` found at `centre` (3,), the tip in the plane before it."""
        station = position.station
        stand = self._traffic.standing(station, position.azimuth_deg, position.elevation_deg)
        nominal = self._traffic.nominal(stand, station)
        off = centre - nominal[ball]
        self._pose = _CurrentPose(stand, station, nominal, nominal + off, self._traffic.roads.unknown_mm)
        out_mm = self._probing.contact_mm + self._probing.narrow.approach_mm
        spot = TipLocation(ball, point(self._probing.directions[0]), out_mm)
        self._at(_TipState(spot, off), centre - self._probing.directions[0] * out_mm)
        yield MoveTo(f"{key}/off-ball", point(self._here))

    def _way_out(self) -> tuple[list[Array], Array] | None:
        """Corners of the way to the parking place, and that; None where none is proved to be free."""
        traffic, there, pose = self._traffic, self._there, self._known_pose
        if there is None or float(np.linalg.norm(there.off)) > traffic.roads.unknown_mm:
            return None
        spot = traffic.axes_at(pose.station, traffic.at(pose.stand, there.spot))
        for aside in PARK_OFFSETS_MM:
            parked = self._inside(self._course.parked(spot + np.array(aside), pose.station))
            way = traffic.to_place(pose.stand, there.spot, point(parked - traffic.axes_at(pose.station, _ORIGIN)))
            if way is not None:
                corners = [traffic.axes_at(pose.station, corner) + there.off for corner in way.corners]
                return [self._inside(corner) for corner in corners], parked
        return None

    def _inside(self, corner: Array) -> Array:
        """Parking places lie at the very end of the travel, and so do corners on the way there: where the artefact
        stands off they would lie beyond it. That much was kept clear of everything."""
        roads = self._traffic.roads
        return np.asarray(np.clip(corner, roads.lower_mm, roads.upper_mm))

    # ------------------------------------------------------------------ at a ball

    def to(self, key: str, ball: int, begin: PlannedTouch) -> Plan[None]:
        """To where a touch of `ball` begins."""
        pose, there = self._known_pose, self._there
        spot = TipLocation(ball, point(begin.direction), begin.out_mm)
        off = begin.centre - pose.nominal[ball]
        corners = self._corners(spot, off, begin)
        feed = begin.search.beside_mm_per_s
        beside = there is not None and there.spot.ball == ball
        if feed is not None and not beside:
            corners = [*corners, _slow_down_point(begin, corners[-1] if corners else self._here)]
        for number, target in enumerate(corners):
            yield MoveTo(f"{key}/via-{number}", point(target), feed if beside else None)
        yield MoveTo(f"{key}/start", point(begin.start), feed)
        self._at(_TipState(spot, off), begin.start)

    def away(self, key: str, ball: int, begin: PlannedTouch, latched_mm: Point | None) -> Plan[None]:
        """Nothing, where the surface was found as expected: the next way begins there. Else back where it was begun."""
        there = self._there
        assert there is not None  # noqa: S101  `to` came before
        if latched_mm is not None and begin.search == self._probing.narrow:
            missed_mm = math.dist(latched_mm, begin.surface.tolist())
            if missed_mm <= self._traffic.roads.known_mm:
                spot = TipLocation(ball, there.spot.direction, begin.contact_mm, touching=True)
                self._at(_TipState(spot, there.off), np.array(latched_mm))
                return
        yield MoveTo(f"{key}/back", point(begin.start))

    def _corners(self, spot: TipLocation, off: Array, begin: PlannedTouch) -> list[Array]:
        """Axis positions on the way."""
        pose, there = self._known_pose, self._there
        if there is None:
            found, self._way_in = self._way_in or (), None
            return [self._traffic.axes_at(pose.station, corner) + off for corner in found]
        mistaken = max(pose.mistaken_mm(off, spot.ball), pose.mistaken_mm(there.off, there.spot.ball))
        place_x = float(self._traffic.layout.location(pose.station)[0])
        way = self._traffic.between(pose.stand, there.spot, spot, pose.uncertain_mm + mistaken, place_x)
        if way is None or math.hypot(*off.tolist()) > self._traffic.roads.unknown_mm:
            return self._plain_corners(there, begin)
        first, last = (self._traffic.at(pose.stand, one) for one in (there.spot, spot))
        return [
            self._traffic.axes_at(pose.station, corner)
            + _interpolated(there.off, off, _fraction_along(corner, first, last))
            for corner in way.corners
        ]

    def _plain_corners(self, there: _TipState, begin: PlannedTouch) -> list[Array]:
        """Back to the plane before the ball on the same one; over the retreat plane to another."""
        here = self._here
        beside = here - np.array(there.spot.direction) * (begin.out_mm - there.spot.out_mm)
        leaving = [beside] if there.spot.touching else []
        before = before_ball(begin, self._probing)
        if float(np.linalg.norm(here - begin.centre)) < 2.0 * begin.out_mm:
            depth = before - begin.centre
            back = beside + self._probing.stylus_axis * float(
                (depth - (beside - begin.centre)) @ self._probing.stylus_axis
            )
            return [*leaving, back, before]
        return [*leaving, self._course.retreated(beside), self._course.retreated(before)]

    def _at(self, there: _TipState, here: Array) -> None:
        self._there, self._here = there, here

    # ------------------------------------------------------------------ between positions

    def _ends(self, task: PlannedPosition, stand: ArtefactPose) -> tuple[int, int]:
        """First and last ball: whichever end is nearer in time to where the tip is."""
        ends = task.balls[0], task.balls[-1]
        way = self._turning(task, stand, ends[0])
        if way is None or self._turning(task, stand, ends[1], faster_than_s=way.seconds) is None:
            return ends
        return ends[::-1]

    def _turning(
        self, task: PlannedPosition, stand: ArtefactPose, ball: int, faster_than_s: float = math.inf
    ) -> TurningPath | None:
        there, pose = self._there, self._pose
        if there is None or pose is None or pose.station != task.station or self._moved_far(there, task):
            return None
        pole = TipLocation(
            ball, point(self._probing.directions[0]), self._probing.contact_mm + self._probing.wide.approach_mm
        )
        place_x = float(self._traffic.layout.location(task.station)[0])
        return self._traffic.turning(pose.stand, there.spot, stand, pole, place_x, faster_than_s)

    def _moved_far(self, there: _TipState, task: PlannedPosition) -> bool:
        """A mount that stands farther off its place than the wide search allows is not met on planned ways."""
        return float(np.linalg.norm(there.off)) > self._traffic.roads.unknown_mm

    def _stand(self, task: PlannedPosition) -> ArtefactPose:
        return self._traffic.standing(task.station, task.azimuth_deg, task.elevation_deg)

    @property
    def _known_pose(self) -> _CurrentPose:
        assert self._pose is not None  # noqa: S101  `turn` came before
        return self._pose


@dataclass(frozen=True, eq=False)
class _BallTouchPath:
    """The ways of one ball."""

    pilot: ShortestPathPlanner
    ball: int

    def to(self, key: str, begin: PlannedTouch) -> Plan[None]:
        yield from self.pilot.to(key, self.ball, begin)

    def away(self, key: str, begin: PlannedTouch, latched_mm: Point | None) -> Plan[None]:
        yield from self.pilot.away(key, self.ball, begin, latched_mm)


def create_path_planner(
    course: Retreat, probing: ProbingParameters, layout: MeasuringLayout
) -> PlainPathPlanner | ShortestPathPlanner:
    """The plain one where no roads are known."""
    if course.roads is None:
        return PlainPathPlanner(course, probing)
    return ShortestPathPlanner(course.roads.among(layout), course, probing)


def _slow_down_point(begin: PlannedTouch, coming_from: Array) -> Array:
    """On the last leg, before where the ball may already be: from here on the tip goes slowly."""
    way = coming_from - begin.start
    length = float(np.linalg.norm(way))
    return np.asarray(begin.start + way * min(1.0, 2.0 * begin.search.approach_mm / max(length, 1e-9)))


def _fraction_along(corner: Corner, first: Corner, last: Corner) -> float:
    """How far along the straight way a corner is, 0 … 1."""
    x, y, z = last[0] - first[0], last[1] - first[1], last[2] - first[2]
    along = (corner[0] - first[0]) * x + (corner[1] - first[1]) * y + (corner[2] - first[2]) * z
    return min(max(along / max(x * x + y * y + z * z, 1e-12), 0.0), 1.0)


def _interpolated(first: Array, last: Array, share: float) -> Array:
    return np.asarray((1.0 - share) * first + share * last)
