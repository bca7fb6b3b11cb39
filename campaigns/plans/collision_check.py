"""Independent collision check: motion is sampled densely in time, and obstacles are represented by point clouds.

The check shares no distance function with the planner or the simulated world. It takes only facts from the world: the
axis positions at an instant, the mount angles, and the location of the artefact. A capsule (cylinder with spherical
ends) at rest is represented by a row of points with a radius, at a fixed spacing (`SPACING_MM`). The probe is
represented by a point for the tip, two segments along the stylus, and a box. The stylus is parallel to a machine axis.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from agent.planning.job import Job
from simulators.world.world import World
from twin.arrays import Array
from twin.artefact.mount_geometry import MountGeometry

SPACING_MM = 1.0
"""Spacing of the points in a row. The nearest point of a row is at most half a spacing away from the exact nearest
location on its line, which adds 0.03 mm to a distance of 4 mm."""
STEP_MM = 0.75
"""Largest motion of the tip, or of the end of a turning bar, between two samples."""
TURN_STEP_MM = 3.0
TOLERANCE_MM = 0.05
"""Error of a computed clearance of zero, caused by the spacing, the steps and the machine's own error."""
CHUNK = 256
HEIGHT = 2
"""Index of the vertical axis."""


@dataclass(frozen=True)
class PointCloud:
    """Point cloud of n points that represents the obstacles.

    `points`, shape (n, 3), and `radii`, shape (n,), are in mm. `body` gives for each point the index in `names` of its
    body. `ball` gives for each point the number of its ball, or -1 if the point does not belong to a ball.
    """

    points: Array
    radii: Array
    body: NDArray[np.intp]
    ball: NDArray[np.intp]
    names: tuple[str, ...]


@dataclass
class JudgeResult:
    """Result of the independent collision check of a run.

    `smallest_mm` is the smallest clearance in mm over all pairs of bodies. The pair of stylus and ball is excluded,
    because contact between these two is intended.
    """

    samples: int = 0
    smallest_mm: float = math.inf
    collisions: list[str] = field(default_factory=list)


class ProbeDimensions:
    """Dimensions of the probe in mm, taken from the settings, and its direction, taken from the machine file.

    The stylus is parallel to the machine axis with the index `axis` and points in the direction `sign`. `has_edge` is
    True if the table begins at the origin: the stylus is horizontal and points from the origin towards the mounts.
    """

    def __init__(self, job: Job, overtravel_mm: float) -> None:
        probe = job.layout.probe
        self.tip, self.stem_radius, self.stem = probe.tip_radius_mm, probe.stem_radius_mm, probe.stem_length_mm
        self.body_radius, self.reach = probe.body_radius_mm, probe.reach_mm
        self.half, self.ram = probe.ram_half_width_mm, probe.ram_length_mm
        self.overtravel = overtravel_mm
        self.table_z = job.settings.mount.table_z_mm
        tool = np.asarray(job.tool_offset_mm)
        self.axis = int(np.abs(tool).argmax())
        self.sign = 1.0 if tool[self.axis] > 0.0 else -1.0
        self.aside = [axis for axis in range(3) if axis != self.axis]
        self.is_vertical = self.axis == HEIGHT
        self.has_edge = not self.is_vertical and self.sign * job.settings.stations.places_mm[0][self.axis] > 0.0


class CollisionJudge:
    """Independent collision check of one run on the simulation `world`.

    The check examines one interval of time after another, each before the world advances by that interval.
    """

    def __init__(self, world: World, job: Job) -> None:
        self._world = world
        self._job = job
        self._tool = np.array(world.controller.tool_offset)
        self.dimensions = ProbeDimensions(job, world.scenario.settings.trigger.overtravel_mm)
        self._seen = JudgeResult()
        self._tips: list[Array] = []
        self._cloud: PointCloud | None = None
        self._snapshot: object = None

    def watch(self, before_s: float, after_s: float) -> None:
        """Check the motion of axes and mount for collisions from machine time `before_s` to `after_s`."""
        mount = self._world.workpiece.mount
        if mount.settled_s > before_s + 1e-9:
            self._watch_turn(before_s, after_s)
            return
        controller = self._world.controller
        if controller.motion_ends_s is None:
            return
        start, end = (np.array(controller.displayed_at(t)) for t in (before_s, after_s))
        count = max(1, math.ceil(float(np.linalg.norm(end - start)) / STEP_MM))
        instants = np.linspace(before_s, after_s, count + 1)
        self._use_snapshot(before_s)
        self._tips.append(np.array([controller.displayed_at(t) for t in instants]) + self._tool)

    def seen(self) -> JudgeResult:
        self._flush()
        return self._seen

    def _watch_turn(self, before_s: float, after_s: float) -> None:
        """Check a turn of the bar, with its pose computed from the encoder angles alone."""
        self._flush()
        self._snapshot = None
        workpiece = self._world.workpiece
        angles = [workpiece.mount.angles_deg(t) for t in (before_s, after_s)]
        turned = math.radians(max(abs(b - a) for a, b in zip(*angles, strict=True)))
        count = max(1, math.ceil(turned * workpiece.sweep_radius_mm / TURN_STEP_MM))
        for instant in np.linspace(before_s, after_s, count + 1)[1:]:
            azimuth, elevation = workpiece.mount.angles_deg(float(instant))
            centre, rotation = pose(workpiece.location_mm, self._job.settings.mount, azimuth, elevation)
            tip = np.array([self._world.controller.displayed_at(float(instant))]) + self._tool
            judge_tips(self._seen, tip, self._cloud_at(centre, rotation), self.dimensions)

    def _use_snapshot(self, instant_s: float) -> None:
        snapshot = self._world.workpiece.snapshot(instant_s)
        if snapshot is not self._snapshot:
            self._flush()
            self._snapshot = snapshot
            self._cloud = self._cloud_at(np.asarray(snapshot.pose.centre), np.asarray(snapshot.pose.rotation))

    def _cloud_at(self, centre: Array, rotation: Array) -> PointCloud:
        return build_cloud(self._job, np.asarray(self._world.workpiece.location_mm), centre, rotation)

    def _flush(self) -> None:
        if self._tips and self._cloud is not None:
            judge_tips(self._seen, np.concatenate(self._tips), self._cloud, self.dimensions)
        self._tips = []


def pose(place: Array, mount: MountGeometry, azimuth_deg: float, elevation_deg: float) -> tuple[Array, Array]:
    """Return the origin of the artefact frame, shape (3,), in mm, and the artefact's rotation matrix, shape (3, 3).

    The columns of the matrix are the directions of the artefact's axes in the workpiece frame.
    """
    a, e = math.radians(azimuth_deg), math.radians(elevation_deg)
    along = np.array([math.cos(e) * math.cos(a), math.cos(e) * math.sin(a), math.sin(e)])
    inward = np.array([-math.sin(a), math.cos(a), 0.0])
    rotation = np.column_stack([along, inward, np.cross(along, inward)])
    shaft = np.array(mount.shaft_direction)
    return np.asarray(place) + rotation @ (shaft * (mount.shaft_mm / np.linalg.norm(shaft))), rotation


def build_cloud(job: Job, place: Array, centre: Array, rotation: Array) -> PointCloud:
    """Return the point cloud that represents all obstacles except the machine table: balls, posts, bar, other parts of
    the artefact, shaft and pedestal.
    """
    mount, balls, body = job.settings.mount, job.artefact.balls, job.artefact.body
    feet = balls * [1.0, 0.0, 0.0] if body.feet_mm is None else np.array(body.feet_mm)
    parts: list[tuple[str, Array, float, int]] = []
    for number, ball in enumerate(balls):
        middle = centre + rotation @ ball
        foot = centre + rotation @ feet[number]
        parts.append((f"ball {number}", middle[None], job.artefact.ball_radius_mm, number))
        parts.append((f"post {number}", _row(foot, middle), body.holder_radius_mm, -1))
    if body.beam is not None:
        ends = [feet[:, 0].min() - body.beam.overhang_mm, feet[:, 0].max() + body.beam.overhang_mm]
        first, last = (centre + rotation[:, 0] * end for end in ends)
        parts.append(("bar", _row(first, last), body.beam.radius_mm, -1))
    for part in body.parts:
        start, end = (centre + rotation @ np.array(point) for point in (part.start_mm, part.end_mm))
        parts.append((part.name, _row(start, end), part.radius_mm, -1))
    below, above = place.copy(), place.copy()
    below[2], above[2] = mount.table_z_mm, place[2] + mount.up * mount.head_mm
    parts += [
        ("shaft", _row(place, centre), mount.shaft_radius_mm, -1),
        ("pedestal", _row(below, above), mount.pedestal_radius_mm, -1),
    ]
    counts = [len(points) for _, points, _, _ in parts]
    return PointCloud(
        np.concatenate([points for _, points, _, _ in parts]),
        np.repeat([radius for _, _, radius, _ in parts], counts),
        np.repeat(np.arange(len(parts)), counts),
        np.repeat([ball for _, _, _, ball in parts], counts),
        tuple(name for name, _, _, _ in parts),
    )


def _row(start: Array, end: Array) -> Array:
    """Return points (n, 3) at most `SPACING_MM` apart from `start` to `end`, both included."""
    count = max(1, math.ceil(float(np.linalg.norm(end - start)) / SPACING_MM)) + 1
    return np.asarray(start + np.linspace(0.0, 1.0, count)[:, None] * (end - start))


def judge_tips(seen: JudgeResult, tips: Array, cloud: PointCloud, dimensions: ProbeDimensions) -> None:
    """Check the probe for collisions with obstacles at n successive positions of its tip centre, `tips` of shape (n, 3)
    in mm.

    The collisions and the smallest clearance are added to the result `seen`.
    """
    for first in range(0, len(tips), CHUNK):
        part = tips[first : first + CHUNK]
        seen.samples += len(part)
        _table(seen, part, dimensions)
        near = _near(part, cloud, dimensions)
        if near.any():
            few = PointCloud(cloud.points[near], cloud.radii[near], cloud.body[near], cloud.ball[near], cloud.names)
            _pairs(seen, part, few, dimensions)


def _near(tips: Array, cloud: PointCloud, dimensions: ProbeDimensions) -> NDArray[np.bool_]:
    """Return the mask of points that any part of the probe could approach, according to a box around all tip
    positions.
    """
    low, high = tips.min(axis=0), tips.max(axis=0)
    room = max(dimensions.half, dimensions.body_radius, dimensions.tip) + 10.0
    low, high = low - room, high + room
    behind = dimensions.reach + dimensions.ram
    if dimensions.sign > 0.0:
        low[dimensions.axis] -= behind
    else:
        high[dimensions.axis] += behind
    wide = cloud.radii[:, None]
    return np.asarray(((cloud.points > low - wide) & (cloud.points < high + wide)).all(axis=1))


def _pairs(seen: JudgeResult, tips: Array, cloud: PointCloud, dimensions: ProbeDimensions) -> None:
    gap = cloud.points[None] - tips[:, None]
    x, z = (gap[..., axis] for axis in dimensions.aside)
    y = dimensions.sign * gap[..., dimensions.axis]
    aside = x * x + z * z
    tip = np.sqrt(aside + y * y) - dimensions.tip - cloud.radii
    is_ball = cloud.ball >= 0
    stem = _from_segment(aside, y, -dimensions.stem, 0.0) - dimensions.stem_radius - cloud.radii
    touched = is_ball & (tip < TOLERANCE_MM)
    stem_counts = np.where(touched, np.inf, stem)
    front, back = -dimensions.stem - dimensions.body_radius, -dimensions.reach + dimensions.body_radius
    body = _from_segment(aside, y, back, front) - dimensions.body_radius - cloud.radii
    beyond = np.maximum(np.abs(np.stack([x, z])) - dimensions.half, 0.0)
    behind = np.maximum(np.maximum(y + dimensions.reach, -dimensions.reach - dimensions.ram - y), 0.0)
    ram = np.sqrt((beyond**2).sum(axis=0) + behind**2) - cloud.radii
    tip_counts = np.where(is_ball, np.where(tip < -dimensions.overtravel, tip, np.inf), tip)
    for name, distance in (("tip", tip_counts), ("stem", stem_counts), ("probe body", body), ("ram", ram)):
        stylus_on_ball = is_ball if name == "stem" else np.zeros_like(is_ball)
        _note(seen, name, distance, stylus_on_ball, cloud)


def _from_segment(aside: Array, y: Array, low: float, high: float) -> Array:
    """Return the distance of points to the segment of the tool axis between `low` and `high`.

    The points are given by `aside`, the square of their distance from the axis in mm², and by their coordinate `y`
    along the axis in mm.
    """
    along = np.maximum(np.maximum(y - high, low - y), 0.0)
    return np.asarray(np.sqrt(aside + along * along))


def _note(seen: JudgeResult, name: str, distance: Array, meant: NDArray[np.bool_], cloud: PointCloud) -> None:
    place = int(distance.argmin())
    column = place % distance.shape[1]
    worst = float(distance.flat[place])
    pair = (name, cloud.names[int(cloud.body[column])])
    if worst < -TOLERANCE_MM:
        seen.collisions.append(f"{pair[0]} with {pair[1]}, {-worst:.3f} mm deep")
    counted = np.where(meant, np.inf, distance)
    smallest = float(counted.min())
    seen.smallest_mm = min(seen.smallest_mm, smallest)


def _table(seen: JudgeResult, tips: Array, dimensions: ProbeDimensions) -> None:
    """Check the clearance to the table, whose top is a plane, unbounded or beginning at the origin in the direction of
    the stylus.
    """
    front, back = -dimensions.stem - dimensions.body_radius, -dimensions.reach + dimensions.body_radius
    for name, first, last, radius in (
        ("tip", 0.0, 0.0, dimensions.tip),
        ("stem", 0.0, -dimensions.stem, dimensions.stem_radius),
        ("probe body", front, back, dimensions.body_radius),
    ):
        _note_table(seen, name, _height_above_table(tips, dimensions, first, last, radius))
    behind = -dimensions.reach - dimensions.ram
    width = 0.0 if dimensions.is_vertical else dimensions.half
    _note_table(seen, "ram", _height_above_table(tips, dimensions, -dimensions.reach, behind, width))


def _height_above_table(tips: Array, dimensions: ProbeDimensions, first: float, last: float, radius: float) -> float:
    """Return the smallest height in mm above the table of a body from `first` to `last` along the stylus, relative to
    the tip, at all tip positions.

    A rounded end that only overhangs the edge of the table is left to the next sample.
    """
    ends = (dimensions.sign * first, dimensions.sign * last) if dimensions.is_vertical else (0.0,)
    height = tips[:, HEIGHT] + min(ends) - radius - dimensions.table_z
    if dimensions.has_edge:
        height = np.where(dimensions.sign * tips[:, dimensions.axis] + first >= 0.0, height, np.inf)
    return float(height.min())


def _note_table(seen: JudgeResult, name: str, clearance: float) -> None:
    if clearance < -TOLERANCE_MM:
        seen.collisions.append(f"{name} with table, {-clearance:.3f} mm deep")
    seen.smallest_mm = min(seen.smallest_mm, clearance)
