"""Fastest collision-free paths of one run: from touch to touch, from ball to ball, and from one pose of the artefact to
the next.

Paths are searched among the bodies at their nominal places, in coordinates relative to the location of the mount. For
this reason, a path that was found once can be used at every station and each time a position is measured. The
uncertainty of the pose is added to the clearance between the bodies. When a path is used, its corners are shifted to
the measured location of the artefact.
"""

from __future__ import annotations

import math
from collections.abc import Hashable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import cached_property, lru_cache
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
from agent.probing.paths.artefact_bodies import ArtefactBodies, ArtefactPose, PosedBodies
from twin.arrays import Array
from twin.collision.accessibility import AT_CONTACT_MM
from twin.collision.bodies import TIP, ball_name, post_name
from twin.collision.free_paths import (
    AxisDynamics,
    Clearances,
    FreePath,
    PathCandidates,
    direct_path,
    fastest_path,
    retract_candidates,
)
from twin.collision.geometry import Point, point
from twin.collision.measuring_layout import MeasuringLayout
from twin.collision.motion_law import travel_times
from twin.collision.swept_volume import CELL_MM
from twin.immutable import content_key

UNCERTAINTY_STEPS_MM = (0.5, 1.0, 2.0, 4.0, 8.0, 16.0, 32.0)
"""Values in mm to which the uncertainty of a pose is rounded up, so that cached paths can be reused."""

WORTHWHILE_RATIO = 0.95
"""Another waiting point is tried only if its lower bound is below this fraction of the best path's time."""

_MAX_WAITING_POINTS = 24
_GRID_MM = 80.0


@dataclass(frozen=True)
class TurningPath:
    """Path of the tip from a ball in the artefact's old pose to a ball in its new pose, by way of a waiting point where
    the tip stays while the mount turns the artefact.

    `exit_path` holds the corners before the waiting point, and `entry_path` the corners after it. The corners and
    `waiting_point` are relative to the location of the mount. `seconds` is the time of both parts without the turn.
    """

    exit_path: tuple[Point, ...]
    waiting_point: Point
    entry_path: tuple[Point, ...]
    seconds: float


@dataclass(frozen=True, eq=False)
class FreePathRules:
    """Rules for free paths, that is, for collision-free paths of the stylus tip.

    `lower_mm` and `upper_mm` (3,) are the limits of the axes' travel. `clearance_mm` is the minimum distance between
    moving and stationary bodies on every path. The uncertainty of the artefact's pose is added to this clearance. The
    uncertainty is `unaligned_uncertainty_mm` until the balls that determine the pose have been measured, and
    `aligned_uncertainty_mm` afterwards.
    """

    lower_mm: Array
    upper_mm: Array
    dynamics: AxisDynamics
    clearance_mm: float
    aligned_uncertainty_mm: float
    unaligned_uncertainty_mm: float
    _finders: dict[MeasuringLayout, FreePathFinder] = field(default_factory=dict, init=False, repr=False)

    def finder_for(self, layout: MeasuringLayout) -> FreePathFinder:
        """Return the path finder for the bodies of `layout`. Every call with this layout returns the same object, which
        holds the paths already found."""
        if layout not in self._finders:
            self._finders[layout] = FreePathFinder(layout, self)
        return self._finders[layout]


@dataclass(frozen=True, eq=False)
class KnownPaths:
    """Paths and lower bounds of times that have been found for one layout and one set of rules. Each depends on its key
    alone, so all runs of the process share them."""

    paths: dict[object, FreePath | None] = field(default_factory=dict)
    turning_estimates: dict[object, float] = field(default_factory=dict)


@lru_cache(maxsize=8)
def _known_paths(layout: MeasuringLayout, rules: Hashable) -> KnownPaths:
    return KnownPaths()


@lru_cache(maxsize=8)
def _bodies(layout: MeasuringLayout, turn_clearance_mm: float) -> ArtefactBodies:
    return ArtefactBodies(layout, turn_clearance_mm)


@dataclass(frozen=True, eq=False)
class FreePathFinder:
    """Finder of collision-free (free) paths of the stylus tip. It stores every path it has found, because each station
    and each verification needs the same paths.

    Paths past a turning artefact are found anew in each run: which one is found depends on the limits of the time with
    which it was asked for before.
    """

    layout: MeasuringLayout
    rules: FreePathRules
    sequences: dict[object, list[int]] = field(default_factory=dict, init=False, repr=False)
    _turning_paths: dict[object, TurningPath | None] = field(default_factory=dict, init=False, repr=False)

    @cached_property
    def known(self) -> KnownPaths:
        return _known_paths(self.layout, content_key(self.rules))

    @cached_property
    def bodies(self) -> ArtefactBodies:
        return _bodies(self.layout, self.rules.clearance_mm + self.rules.unaligned_uncertainty_mm)

    def pose_at(self, station: int, azimuth_deg: float, elevation_deg: float) -> ArtefactPose:
        across = self.layout.across_stations(self.layout.location(station))
        alone = not (self.layout.neighbours or self.layout.own_artefacts)
        return ArtefactPose(azimuth_deg, elevation_deg, across, 0 if alone else station)

    def axes_at(self, station: int, corner: Point) -> Array:
        """Return the axis positions (3,) that bring the tip centre to the point `corner`. `corner` is relative to the
        location of the artefact's mount at `station`."""
        return np.asarray(self.layout.location(station) - self.layout.tool_offset_mm + corner)

    def ball_axes(self, pose: ArtefactPose, station: int) -> Array:
        """Return the nominal axis positions (N, 3) that bring the tip centre to the centre of each of the N balls."""
        return np.asarray(self.bodies.posed(pose).centres + self.axes_at(station, (0.0, 0.0, 0.0)))

    def tip_at(self, pose: ArtefactPose, location: TipLocation) -> Point:
        """Return the coordinates of the tip centre at `location`, relative to the location of the artefact's mount."""
        (x, y, z), (along_x, along_y, along_z) = (
            self.bodies.posed(pose).centre_points[location.ball],
            location.direction,
        )
        return x - along_x * location.out_mm, y - along_y * location.out_mm, z - along_z * location.out_mm

    def path_between(
        self, pose: ArtefactPose, start: TipLocation, end: TipLocation, uncertainty_mm: float, station: int
    ) -> FreePath | None:
        """Return the fastest free (collision-free) path from `start` to `end`; None if no path is proved free.

        The corners of the path are relative to the location of the artefact's mount. `uncertainty_mm` is the largest
        deviation of the artefact from `pose`. `station` is the number of the station, which is needed to keep the path
        within the travel of the station axis.
        """
        uncertainty_mm = round_up_uncertainty(uncertainty_mm)
        unlimited = self._cached_path(pose, start, end, uncertainty_mm, (-math.inf, math.inf))
        low, high = self._range_along_stations(station)
        along = self.layout.station_axis
        if unlimited is None or all(low <= corner[along] <= high for corner in unlimited.corners):
            return unlimited
        return self._cached_path(pose, start, end, uncertainty_mm, (low, high))

    def _cached_path(
        self,
        pose: ArtefactPose,
        start: TipLocation,
        end: TipLocation,
        uncertainty_mm: float,
        along_range: tuple[float, float],
    ) -> FreePath | None:
        key = (pose, start, end, uncertainty_mm, along_range)
        if key not in self.known.paths:
            self.known.paths[key] = self._search_path(*key)
        return self.known.paths[key]

    def straight_seconds(self, pose: ArtefactPose, starts: Sequence[TipLocation], ends: Sequence[TipLocation]) -> Array:
        """Return the times in s of the straight paths from each of n starts to each of m ends, as an array of shape (n,
        m). Each time is a lower bound for the time of a collision-free path."""
        first, last = (
            np.array([self.tip_at(pose, location) for location in locations]) for locations in (starts, ends)
        )
        return self._straight_times(first[:, None], last[None])

    def turning_path(
        self,
        before: ArtefactPose,
        start: TipLocation,
        after: ArtefactPose,
        end: TipLocation,
        station: int,
        faster_than_s: float = math.inf,
    ) -> TurningPath | None:
        """Return a collision-free path from `start` in the pose `before` to `end` in the pose `after`, by way of a
        waiting point where the tip stays while the artefact turns. The result is None if no path faster than
        `faster_than_s` is proved free."""
        (low, high), reach = self._range_along_stations(station), self._reach_mm(after)
        key = (before, start, after, end, (max(low, -reach), min(high, reach)))
        if key not in self._turning_paths:
            found = self._search_turning_path(*key, faster_than_s)
            if found is None and faster_than_s < math.inf:
                return None
            self._turning_paths[key] = found
        path = self._turning_paths[key]
        return path if path is not None and path.seconds < faster_than_s else None

    def min_turning_seconds(
        self, before: ArtefactPose, starts: Sequence[TipLocation], after: ArtefactPose, ends: Sequence[TipLocation]
    ) -> float:
        """Return a lower bound in s for the time of the fastest path from any of `starts` to any of `ends`. On this
        path, the artefact is turned from the pose `before` to the pose `after`; the time of the turn is not included.

        The bound assumes that every path in front of the turning artefact is free of collisions. The path returned by
        `turning_path` is rarely much slower.
        """
        reach = self._reach_mm(after)
        pairs = product([self.tip_at(before, start) for start in starts], [self.tip_at(after, end) for end in ends])
        first, last = (np.array(one) for one in zip(*pairs, strict=True))
        points, clear = self._waiting_points(before, after, first, last, (-reach, reach))
        return float(np.where(clear, self._seconds_by_way_of(points, first, last), math.inf).min())

    def _range_along_stations(self, station: int) -> tuple[float, float]:
        """Return the limits of the tip's travel along the station axis in mm, relative to the mount's location."""
        along = self.layout.station_axis
        location_mm = float(self.layout.location(station)[along])
        low, high = (
            float(end[along] + self.layout.tool_offset_mm[along]) - location_mm
            for end in (self.rules.lower_mm, self.rules.upper_mm)
        )
        return low, high

    # ------------------------------------------------------------------ touches and balls

    def _search_path(
        self,
        pose: ArtefactPose,
        start: TipLocation,
        end: TipLocation,
        uncertainty_mm: float,
        along_range: tuple[float, float],
    ) -> FreePath | None:
        posed = self.bodies.posed(pose)
        first, last = self.tip_at(pose, start), self.tip_at(pose, end)
        groups = self._corners(pose, start, last, end.out_mm - start.out_mm)
        if start.ball == end.ball:
            groups.append(detour_corners(posed.centres[start.ball], start, end, self.layout.frame.stylus_axis))
        candidates = lifting_off(first, PathCandidates.of(groups), start)
        low, high = self._travel(pose)
        low[self.layout.station_axis], high[self.layout.station_axis] = along_range
        candidates = candidates.inside(low, high)
        for clearances in self._clearance_options(start, end, uncertainty_mm):
            path = self._direct_path(posed, first, last, start, clearances)
            path = path or fastest_path(posed.prefiltered, self.rules.dynamics, first, last, candidates, clearances)
            if path is not None:
                return path
        return None

    def _direct_path(
        self, posed: PosedBodies, first: Point, last: Point, start: TipLocation, clearances: Clearances
    ) -> FreePath | None:
        """Return the straight path; None if it is not free, or does not leave the surface at once."""
        if not lifts_off(first, last, start):
            return None
        return direct_path(posed.prefiltered.scene, self.rules.dynamics, first, last, clearances)

    def _corners(self, pose: ArtefactPose, start: TipLocation, last: Point, beside_mm: float) -> list[Array]:
        """Return arrays (n, k, 3), each with the k corners of n candidate paths from `start`. If the tip touches the
        ball, some paths first lift off by `beside_mm`."""
        aside = -beside_mm * np.array(start.direction) if start.touching else None
        stylus_axis = self.layout.frame.stylus_axis
        retract_limit = min(float(end @ stylus_axis) for end in self._travel(pose))
        return retract_candidates(self.tip_at(pose, start), last, -stylus_axis, retract_limit, aside)

    def _clearance_options(self, start: TipLocation, end: TipLocation, uncertainty_mm: float) -> Iterator[Clearances]:
        """Yield two sets of clearances from all bodies, the stricter set first.

        In both sets, the balls at the path ends have a smaller clearance, because they are touched. In the second set,
        the clearance from the holders of these balls does not include the uncertainty of the pose, because a holder
        moves with its ball.
        """
        clearance_mm = self.rules.clearance_mm + uncertainty_mm
        balls = {start.ball, end.ball}
        ball_clearance_mm = min(clearance_mm, end.out_mm - self._contact_mm - 1e-3)
        near = {(body, ball_name(ball)): ball_clearance_mm for body in (TIP, "stem") for ball in balls}
        yield Clearances(clearance_mm, near)
        holders = {(body, post_name(ball)): self.rules.clearance_mm for body in (TIP, "stem") for ball in balls}
        yield Clearances(clearance_mm, near | holders)

    # ------------------------------------------------------------------ turning

    def _search_turning_path(
        self,
        before: ArtefactPose,
        start: TipLocation,
        after: ArtefactPose,
        end: TipLocation,
        along_range: tuple[float, float],
        faster_than_s: float,
    ) -> TurningPath | None:
        """Return the fastest path by way of a waiting point; None if no path is proved free.

        Waiting points are tried in the order of the lower bounds of their times, until a bound is not below
        `WORTHWHILE_RATIO` times the best time found.
        """
        first, last = (np.array([self.tip_at(*one)]) for one in ((before, start), (after, end)))
        (candidates,), (clear,) = self._waiting_points(before, after, first, last, along_range)
        points = candidates[clear]
        lower_bounds = self._seconds_by_way_of(points[None], first, last)[0]
        best: TurningPath | None = None
        worth_s = faster_than_s
        for index in np.argsort(lower_bounds, kind="stable")[:_MAX_WAITING_POINTS].tolist():
            if lower_bounds[index] >= worth_s:
                break
            better = self._turning_path_by(point(points[index]), before, start, after, end, faster_than_s)
            if better is not None:
                best, faster_than_s, worth_s = better, better.seconds, WORTHWHILE_RATIO * better.seconds
        return best

    def _turning_path_by(
        self,
        waiting_point: Point,
        before: ArtefactPose,
        start: TipLocation,
        after: ArtefactPose,
        end: TipLocation,
        faster_than_s: float,
    ) -> TurningPath | None:
        """Return the path by way of `waiting_point`; None if one of its two parts is not free, or if it takes
        `faster_than_s` or longer."""
        exit_path = self.path_to_point(before, start, waiting_point)
        if (
            exit_path is None
            or exit_path.seconds + self._straight_seconds(waiting_point, self.tip_at(after, end)) >= faster_than_s
        ):
            return None
        entry_path = self.path_to_point(after, end, waiting_point)
        if entry_path is None or exit_path.seconds + entry_path.seconds >= faster_than_s:
            return None
        return TurningPath(
            exit_path.corners, waiting_point, entry_path.corners[::-1], exit_path.seconds + entry_path.seconds
        )

    def _seconds_by_way_of(self, points: Array, first: Array, last: Array) -> Array:
        """Return lower bounds (c, n) in s of the times from `first` (c, 3) via `points` (c, n, 3) to `last` (c, 3)."""
        return self._straight_times(first[:, None], points) + self._straight_times(points, last[:, None])

    def _waiting_points(
        self, before: ArtefactPose, after: ArtefactPose, first: Array, last: Array, along_range: tuple[float, float]
    ) -> tuple[Array, NDArray[np.bool_]]:
        """Return n waiting points for each of c pairs of path ends, as an array (c, n, 3), and a mask (c, n) that is
        True for points within the travel. `first` and `last` have the shape (c, 3).

        The points lie in front of the volume swept by the turn, on a grid across the stylus that also contains both
        path ends. They are computed in the probe frame, in which the stylus points along +Y.
        """
        frame, along = self.layout.frame, self.layout.station_axis
        lower, upper = self._travel(before)
        lower[along], upper[along] = along_range
        low, high = frame.box_in_frame(lower, upper)
        first, last = frame.to_frame(first), frame.to_frame(last)
        x, z = (self._grid_along(first[:, k], last[:, k], low[k], high[k]) for k in (0, 2))
        x, z = np.broadcast_arrays(x[:, None, :], z[:, :, None])
        deepest = np.maximum(first[:, 1], last[:, 1])[:, None, None]
        # Depth of the front of the swept volume at (x, z), but never deeper than the deeper end.
        y = np.minimum(self.bodies.sweep(before, after).at(x, z), deepest)
        points = np.stack([x, y, z], axis=-1).reshape(len(first), -1, 3)
        return frame.to_workpiece(points), points[..., 1] >= low[1]

    @staticmethod
    def _grid_along(first: Array, last: Array, low: float, high: float) -> Array:
        """Return n coordinates along one axis for each of c pairs of path ends, as an array (c, n). They are those of
        both ends, their midpoint, and a grid over the travel."""
        grid = np.arange(low, high, _GRID_MM)
        every = np.broadcast_to(grid, (len(first), len(grid)))
        return np.asarray(np.clip(np.column_stack([first, last, 0.5 * (first + last), every]), low, high))

    def path_to_point(self, pose: ArtefactPose, location: TipLocation, waiting_point: Point) -> FreePath | None:
        """Return the fastest free (collision-free) path from `location` to `waiting_point`; None if no path is proved
        free. Its corners are relative to the location of the artefact's mount.

        The reversed path leads from the waiting point to the ball.
        """
        key = (pose, location, waiting_point)
        if key not in self.known.paths:
            self.known.paths[key] = self._search_path_to_point(*key)
        return self.known.paths[key]

    def _search_path_to_point(self, pose: ArtefactPose, location: TipLocation, waiting_point: Point) -> FreePath | None:
        clearance_mm = self.rules.clearance_mm + self.rules.unaligned_uncertainty_mm
        near_mm = min(clearance_mm, max(location.out_mm - self._contact_mm - 1e-3, AT_CONTACT_MM))
        names = ball_name(location.ball), post_name(location.ball)
        clearances = Clearances(clearance_mm, {(body, name): near_mm for body in (TIP, "stem") for name in names})
        posed, first = self.bodies.posed(pose), self.tip_at(pose, location)
        path = self._direct_path(posed, first, waiting_point, location, clearances)
        if path is not None:
            return path
        groups = [
            *self._corners(pose, location, waiting_point, LIFT_OFF_MM),
            rectangular_exit(first, waiting_point, location, self.layout.frame, self.layout.station_axis),
        ]
        candidates = lifting_off(first, PathCandidates.of(groups), location)
        return fastest_path(posed.prefiltered, self.rules.dynamics, first, waiting_point, candidates, clearances)

    def _straight_times(self, start: Array, end: Array) -> Array:
        dynamics = self.rules.dynamics
        return travel_times(start, end, dynamics.rapid_mm_per_s, dynamics.acceleration_mm_per_s2) + dynamics.command_s

    def _straight_seconds(self, start: Point, end: Point) -> float:
        return float(self._straight_times(np.array(start), np.array(end)))

    def _travel(self, pose: ArtefactPose) -> tuple[Array, Array]:
        """Return the lower and upper limits (3,) of the tip's travel, reduced by the uncertainty of the unaligned pose.

        The coordinate along the station axis is relative to the workpiece frame, the other two to the mount's
        location."""
        shift, margin_mm = self.layout.tool_offset_mm - pose.across_mm, self.rules.unaligned_uncertainty_mm
        return self.rules.lower_mm + shift + margin_mm, self.rules.upper_mm + shift - margin_mm

    def _reach_mm(self, pose: ArtefactPose) -> float:
        # The travel along the stations is cut to this distance, so that stations whose travel extends farther share
        # their cached paths. Ten cells reach beyond everything that limits the tip during a turn (see `turn_sweep`), so
        # it can still wait beside the turning artefact. The number is not critical: with 0 to 20 cells, the planned
        # times of the shipped cases differ by less than 0.1 %.
        return (
            self.bodies.cover(pose).reach_mm
            + self.layout.probe.ram_half_width_mm
            + self.rules.unaligned_uncertainty_mm
            + 10.0 * CELL_MM
        )

    @property
    def _contact_mm(self) -> float:
        return self.layout.contact_mm


def round_up_uncertainty(uncertainty_mm: float) -> float:
    """Return `uncertainty_mm` rounded up to the next value of the list `UNCERTAINTY_STEPS_MM`, or unchanged if it
    exceeds the largest value of the list."""
    return next((value for value in UNCERTAINTY_STEPS_MM if uncertainty_mm <= value), uncertainty_mm)
