"""The shortest free ways of one run: from touch to touch, from ball to ball, and out of one pose into the next.

Ways are sought among the bodies as they stand by the drawings, in coordinates that begin at the place of the mount,
so that what was found once holds at every station and however often a position is measured. What is known better or
worse about the pose goes into the clearance. The corners are then carried over to where the artefact was found.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from itertools import product

import numpy as np
from numpy.typing import NDArray

from agent.probing.paths.approach_points import (
    LIFT_OFF_MM,
    TipLocation,
    detour_corners,
    lifting_off,
    lifts_off,
    rectangular_exit,
)
from twin.arrays import Array
from twin.artefact.artefact import Artefact
from twin.collision.accessibility import AT_CONTACT_MM, measuring_scene
from twin.collision.bodies import TIP, ProbeGeometry, ball_name, post_name
from twin.collision.free_paths import (
    AxisDynamics,
    Clearances,
    FreePath,
    PathCandidates,
    PrefilteredScene,
    direct_path,
    fastest_path,
    retract_candidates,
)
from twin.collision.geometry import Point, Shape, point
from twin.collision.measuring_layout import MeasuringLayout
from twin.collision.motion_law import travel_times
from twin.collision.swept_volume import CELL_MM, SphereCover, TurnSweep, cover_turning_bodies, turn_sweep

UNCERTAINTY_STEPS_MM = (0.5, 1.0, 2.0, 4.0, 8.0, 16.0, 32.0)
"""What a pose is off by is rounded up to one of these, so that few ways serve many."""

WORTHWHILE_RATIO = 0.95
"""A place to wait while the mount turns is not bettered for less than this."""

_MAX_WAITING_POINTS = 24
_GRID_MM = 80.0


@dataclass(frozen=True)
class ArtefactPose:
    """How the artefact stands: the mount's angles, and depth and height of its place (workpiece frame).

    `among`: the station, where something else than this mount stands in the workspace; 0 where all stations are alike.
    """

    azimuth_deg: float
    elevation_deg: float
    depth_mm: float
    height_mm: float
    among: int = 0


@dataclass(frozen=True)
class TurningPath:
    """Out of the old pose, and from where the tip waits while the mount turns, into the new one. Corners and `waiting`
    relative to the place of the mount; `seconds` of both ways."""

    out: tuple[Point, ...]
    waiting: Point
    into: tuple[Point, ...]
    seconds: float


@dataclass(eq=False)
class _PosedBodies:
    """Ball centres (N, 3), also one by one, and all bodies, relative to the place of the mount."""

    centres: Array
    places: Sequence[Point]
    among: PrefilteredScene


@dataclass(frozen=True, eq=False)
class FreePathRules:
    """`stylus_axis` (3,): unit vector along which the stylus points. `lower_mm`, `upper_mm` (3,): travel of the axes.
    `clearance_mm`: what every two bodies keep on every way, beside what the pose may be off by: `known_mm` once the end
    balls are found, `unknown_mm` before.
    """

    stylus_axis: Array
    lower_mm: Array
    upper_mm: Array
    dynamics: AxisDynamics
    clearance_mm: float
    known_mm: float
    unknown_mm: float
    _traffic: dict[MeasuringLayout, FreePathFinder] = field(default_factory=dict, init=False, repr=False)

    def among(self, layout: MeasuringLayout) -> FreePathFinder:
        """The ways among what stands as `layout` says; the same each time, with all that was found."""
        if layout not in self._traffic:
            self._traffic[layout] = FreePathFinder(layout, self)
        return self._traffic[layout]


@dataclass(frozen=True, eq=False)
class FreePathFinder:
    """Every way that was asked for is kept: the same ones are asked for at every station, and again in every proof."""

    layout: MeasuringLayout
    roads: FreePathRules
    estimates: dict[object, float] = field(default_factory=dict, init=False, repr=False)
    sequences: dict[object, list[int]] = field(default_factory=dict, init=False, repr=False)
    _covers: dict[int, SphereCover] = field(default_factory=dict, init=False, repr=False)
    _poses: dict[ArtefactPose, _PosedBodies] = field(default_factory=dict, init=False, repr=False)
    _sweeps: dict[object, TurnSweep] = field(default_factory=dict, init=False, repr=False)
    _ways: dict[object, FreePath | None] = field(default_factory=dict, init=False, repr=False)
    _turning: dict[object, TurningPath | None] = field(default_factory=dict, init=False, repr=False)

    def standing(self, station: int, azimuth_deg: float, elevation_deg: float) -> ArtefactPose:
        _, depth, height = point(self.layout.location(station))
        alone = not (self.layout.neighbours or self.layout.own_artefacts)
        return ArtefactPose(azimuth_deg, elevation_deg, depth, height, 0 if alone else station)

    def axes_at(self, station: int, corner: Point) -> Array:
        """(3,) axis positions of a tip centre relative to the place of the mount at `station`."""
        return np.asarray(self.layout.location(station) - self.layout.tool_offset_mm + corner)

    def nominal(self, stand: ArtefactPose, station: int) -> Array:
        """(N, 3) axis positions of all balls."""
        return np.asarray(self._pose(stand).centres + self.axes_at(station, (0.0, 0.0, 0.0)))

    def at(self, stand: ArtefactPose, spot: TipLocation) -> Point:
        """Tip centre at `spot`, relative to the place of the mount."""
        (x, y, z), (along_x, along_y, along_z) = self._pose(stand).places[spot.ball], spot.direction
        return x - along_x * spot.out_mm, y - along_y * spot.out_mm, z - along_z * spot.out_mm

    def between(
        self, stand: ArtefactPose, start: TipLocation, end: TipLocation, uncertain_mm: float, place_x_mm: float
    ) -> FreePath | None:
        """The fastest free way, relative to the place of the mount at `place_x_mm`; None where no way is proved to be
        free. `uncertain_mm`: by so much the artefact may stand off.
        """
        uncertain_mm = round_up_uncertainty(uncertain_mm)
        anywhere = self._known_way(stand, start, end, uncertain_mm, (-math.inf, math.inf))
        low, high = self._room(place_x_mm)
        if anywhere is None or all(low <= x <= high for x, _, _ in anywhere.corners):
            return anywhere
        return self._known_way(stand, start, end, uncertain_mm, (low, high))

    def _known_way(
        self, stand: ArtefactPose, start: TipLocation, end: TipLocation, uncertain_mm: float, room: tuple[float, float]
    ) -> FreePath | None:
        key = (stand, start, end, uncertain_mm, room)
        if key not in self._ways:
            self._ways[key] = self._sought(*key)
        return self._ways[key]

    def straight_seconds(
        self, stand: ArtefactPose, starts: Sequence[TipLocation], ends: Sequence[TipLocation]
    ) -> Array:
        """(n, m): no way from one to the other is faster."""
        first, last = (np.array([self.at(stand, spot) for spot in spots]) for spots in (starts, ends))
        return self._straight(first[:, None], last[None])

    def turning(
        self,
        before: ArtefactPose,
        start: TipLocation,
        after: ArtefactPose,
        end: TipLocation,
        place_x_mm: float,
        faster_than_s: float = math.inf,
    ) -> TurningPath | None:
        """From `start` in one pose to `end` in the next; None where nothing proved to be free was found that takes less
        than `faster_than_s`."""
        (low, high), reach = self._room(place_x_mm), self._reach_mm(after)
        key = (before, start, after, end, (max(low, -reach), min(high, reach)))
        if key not in self._turning:
            found = self._waiting_place(*key, faster_than_s)
            if found is None and faster_than_s < math.inf:
                return None
            self._turning[key] = found
        way = self._turning[key]
        return way if way is not None and way.seconds < faster_than_s else None

    def least_turning_seconds(
        self, before: ArtefactPose, starts: Sequence[TipLocation], after: ArtefactPose, ends: Sequence[TipLocation]
    ) -> float:
        """From the best of `starts` to the best of `ends`, as if every way before the turning artefact were free; the
        turn itself not included. What `turning` finds is rarely much slower."""
        reach = self._reach_mm(after)
        pairs = product([self.at(before, start) for start in starts], [self.at(after, end) for end in ends])
        first, last = (np.array(one) for one in zip(*pairs, strict=True))
        places, clear = self._offered(before, after, first, last, (-reach, reach))
        return float(np.where(clear, self._by_way_of(places, first, last), math.inf).min())

    def _room(self, place_x_mm: float) -> tuple[float, float]:
        """Travel of the tip along X, relative to the place."""
        low, high = (
            float(end[0] + self.layout.tool_offset_mm[0]) - place_x_mm
            for end in (self.roads.lower_mm, self.roads.upper_mm)
        )
        return low, high

    # ------------------------------------------------------------------ touches and balls

    def _sought(
        self, stand: ArtefactPose, start: TipLocation, end: TipLocation, uncertain_mm: float, room: tuple[float, float]
    ) -> FreePath | None:
        pose = self._pose(stand)
        first, last = self.at(stand, start), self.at(stand, end)
        groups = self._corners(stand, start, last, end.out_mm - start.out_mm)
        if start.ball == end.ball:
            groups.append(detour_corners(pose.centres[start.ball], start, end, self.roads.stylus_axis))
        candidates = lifting_off(first, PathCandidates.of(groups), start)
        low, high = self._travel(stand)
        low[0], high[0] = room
        candidates = candidates.inside(low, high)
        for apart in self._aparts(start, end, uncertain_mm):
            way = self._straight_way(pose, first, last, start, apart)
            way = way or fastest_path(pose.among, self.roads.dynamics, first, last, candidates, apart)
            if way is not None:
                return way
        return None

    def _straight_way(
        self, pose: _PosedBodies, first: Point, last: Point, start: TipLocation, apart: Clearances
    ) -> FreePath | None:
        """None where it does not leave the surface at once, too."""
        if not lifts_off(first, last, start):
            return None
        return direct_path(pose.among.scene, self.roads.dynamics, first, last, apart)

    def _corners(self, stand: ArtefactPose, start: TipLocation, last: Point, beside_mm: float) -> list[Array]:
        """Candidates (n, k, 3) from `start`, from a touch such as leave the surface by `beside_mm` first if need be."""
        aside = -beside_mm * np.array(start.direction) if start.touching else None
        least = float(self._travel(stand)[0] @ np.abs(self.roads.stylus_axis))
        return retract_candidates(self.at(stand, start), last, -self.roads.stylus_axis, least, aside)

    def _aparts(self, start: TipLocation, end: TipLocation, uncertain_mm: float) -> Iterator[Clearances]:
        """What is kept from everything; less from the balls at both ends, whose surface the touch is to find, and
        from their holders, which stand by their balls wherever these are."""
        apart_mm = self.roads.clearance_mm + uncertain_mm
        balls = {start.ball, end.ball}
        begins_mm = min(apart_mm, end.out_mm - self._contact_mm - 1e-3)
        near = {(body, ball_name(ball)): begins_mm for body in (TIP, "stem") for ball in balls}
        yield Clearances(apart_mm, near)
        holders = {(body, post_name(ball)): self.roads.clearance_mm for body in (TIP, "stem") for ball in balls}
        yield Clearances(apart_mm, near | holders)

    # ------------------------------------------------------------------ turning

    def _waiting_place(
        self,
        before: ArtefactPose,
        start: TipLocation,
        after: ArtefactPose,
        end: TipLocation,
        between_mm: tuple[float, float],
        faster_than_s: float,
    ) -> TurningPath | None:
        """The first of the places, by what they cost at least, to which and from which a way is free."""
        first, last = (np.array([self.at(*one)]) for one in ((before, start), (after, end)))
        (offered,), (clear,) = self._offered(before, after, first, last, between_mm)
        places = offered[clear]
        least = self._by_way_of(places[None], first, last)[0]
        best: TurningPath | None = None
        worth_s = faster_than_s
        for index in np.argsort(least, kind="stable")[:_MAX_WAITING_POINTS].tolist():
            if least[index] >= worth_s:
                break
            better = self._waiting_at(point(places[index]), before, start, after, end, faster_than_s)
            if better is not None:
                best, faster_than_s, worth_s = better, better.seconds, WORTHWHILE_RATIO * better.seconds
        return best

    def _waiting_at(
        self,
        waiting: Point,
        before: ArtefactPose,
        start: TipLocation,
        after: ArtefactPose,
        end: TipLocation,
        faster_than_s: float,
    ) -> TurningPath | None:
        """The way there and on, where both are free and it is faster than that."""
        out = self.to_place(before, start, waiting)
        if out is None or out.seconds + self._straight_s(waiting, self.at(after, end)) >= faster_than_s:
            return None
        into = self.to_place(after, end, waiting)
        if into is None or out.seconds + into.seconds >= faster_than_s:
            return None
        return TurningPath(out.corners, waiting, into.corners[::-1], out.seconds + into.seconds)

    def _by_way_of(self, places: Array, first: Array, last: Array) -> Array:
        """(c, n) seconds at the least from `first` (c, 3) to `places` (c, n, 3) and on to `last` (c, 3)."""
        return self._straight(first[:, None], places) + self._straight(places, last[:, None])

    def _offered(
        self, before: ArtefactPose, after: ArtefactPose, first: Array, last: Array, between_mm: tuple[float, float]
    ) -> tuple[Array, NDArray[np.bool_]]:
        """(c, n, 3) for ends (c, 3): places before everything that turns, a grid and straight before both ends; (c, n)
        whether each is inside the travel."""
        low, high = self._travel(before)
        low[0], high[0] = between_mm
        x, z = (self._grid(first[:, k], last[:, k], low[k], high[k]) for k in (0, 2))
        x, z = np.broadcast_arrays(x[:, None, :], z[:, :, None])
        deepest = np.maximum(first[:, 1], last[:, 1])[:, None, None]
        y = np.minimum(self._sweep(before, after).at(x, z), deepest)
        places = np.stack([x, y, z], axis=-1).reshape(len(first), -1, 3)
        return places, places[..., 1] >= low[1]

    @staticmethod
    def _grid(first: Array, last: Array, low: float, high: float) -> Array:
        """(c, n) along one axis: at both ends (c,), in between, and every so often."""
        steps = np.arange(low, high, _GRID_MM)
        every = np.broadcast_to(steps, (len(first), len(steps)))
        return np.asarray(np.clip(np.column_stack([first, last, 0.5 * (first + last), every]), low, high))

    def to_place(self, stand: ArtefactPose, spot: TipLocation, waiting: Point) -> FreePath | None:
        """Out from `spot` to a place relative to that of the mount, before the artefact; None where no way is proved
        to be free. The way in is the same backwards."""
        key = (stand, spot, waiting)
        if key not in self._ways:
            self._ways[key] = self._sought_to_place(*key)
        return self._ways[key]

    def _sought_to_place(self, stand: ArtefactPose, spot: TipLocation, waiting: Point) -> FreePath | None:
        apart_mm = self.roads.clearance_mm + self.roads.unknown_mm
        near_mm = min(apart_mm, max(spot.out_mm - self._contact_mm - 1e-3, AT_CONTACT_MM))
        names = ball_name(spot.ball), post_name(spot.ball)
        apart = Clearances(apart_mm, {(body, name): near_mm for body in (TIP, "stem") for name in names})
        pose, first = self._pose(stand), self.at(stand, spot)
        way = self._straight_way(pose, first, waiting, spot, apart)
        if way is not None:
            return way
        groups = [*self._corners(stand, spot, waiting, LIFT_OFF_MM), rectangular_exit(first, waiting, spot)]
        candidates = lifting_off(first, PathCandidates.of(groups), spot)
        return fastest_path(pose.among, self.roads.dynamics, first, waiting, candidates, apart)

    def _sweep(self, before: ArtefactPose, after: ArtefactPose) -> TurnSweep:
        low, high = (
            tuple(choose(a, b) for a, b in zip(_angles(before), _angles(after), strict=True)) for choose in (min, max)
        )
        key = (low, high, after.depth_mm, after.height_mm, after.among)
        if key not in self._sweeps:
            self._sweeps[key] = turn_sweep(
                self._cover(after),
                self.layout.probe,
                self._standing_still(after),
                (low[0], low[1]),
                (high[0], high[1]),
                clearance_mm=self.roads.clearance_mm + self.roads.unknown_mm,
            )
        return self._sweeps[key]

    def _standing_still(self, stand: ArtefactPose) -> list[Shape]:
        """What does not turn with the mount: its pedestal, the table and what else is there."""
        scene = self._pose(stand).among.scene
        carried = self._artefact(stand).count
        turning = {"shaft", "bar", *map(ball_name, range(carried)), *map(post_name, range(carried))}
        return [body.shape for body in scene.obstacles if body.name not in turning]

    def _straight(self, start: Array, end: Array) -> Array:
        dynamics = self.roads.dynamics
        return travel_times(start, end, dynamics.rapid_mm_per_s, dynamics.acceleration_mm_per_s2) + dynamics.command_s

    def _straight_s(self, start: Point, end: Point) -> float:
        return float(self._straight(np.array(start), np.array(end)))

    def _travel(self, stand: ArtefactPose) -> tuple[Array, Array]:
        """Of the tip, relative to the place, along X to the table; less what the artefact may stand off."""
        place = np.array([0.0, stand.depth_mm, stand.height_mm])
        shift, room = self.layout.tool_offset_mm - place, self.roads.unknown_mm
        return self.roads.lower_mm + shift + room, self.roads.upper_mm + shift - room

    # ------------------------------------------------------------------ bodies

    def _cover(self, stand: ArtefactPose) -> SphereCover:
        if stand.among not in self._covers:
            self._covers[stand.among] = cover_turning_bodies(self._artefact(stand), self.layout.mount)
        return self._covers[stand.among]

    def _artefact(self, stand: ArtefactPose) -> Artefact:
        return self.layout.artefact_at(stand.among)

    def _reach_mm(self, stand: ArtefactPose) -> float:
        return (
            self._cover(stand).reach_mm + self.layout.probe.ram_half_width_mm + self.roads.unknown_mm + 10.0 * CELL_MM
        )

    @property
    def _probe(self) -> ProbeGeometry:
        """With a stem as thick as the tip: then what the tip sweeps straight back, from anywhere, is free."""
        probe = self.layout.probe
        return replace(probe, stem_radius_mm=max(probe.stem_radius_mm, probe.tip_radius_mm))

    @property
    def _contact_mm(self) -> float:
        return self.layout.contact_mm

    def _pose(self, stand: ArtefactPose) -> _PosedBodies:
        if stand not in self._poses:
            x = float(self.layout.location(stand.among)[0]) if stand.among else 0.0
            centres, scene = measuring_scene(
                self._artefact(stand),
                self._probe,
                self.layout.mount,
                location_mm=np.array([x, stand.depth_mm, stand.height_mm]),
                azimuth_rad=math.radians(stand.azimuth_deg),
                elevation_rad=math.radians(stand.elevation_deg),
                other_bodies=self.layout.neighbours.get(stand.among, ()),
            )
            back = (-x, -stand.depth_mm, -stand.height_mm)
            self._poses[stand] = _PosedBodies(
                centres + back,
                [point(centre) for centre in centres + back],
                PrefilteredScene.of(scene.translated(back)),
            )
        return self._poses[stand]


def round_up_uncertainty(uncertain_mm: float) -> float:
    """To the next of `UNCERTAINTY_STEPS_MM`, beyond the last as it is."""
    return next((value for value in UNCERTAINTY_STEPS_MM if uncertain_mm <= value), uncertain_mm)


def _angles(stand: ArtefactPose) -> tuple[float, float]:
    return stand.azimuth_deg, stand.elevation_deg
