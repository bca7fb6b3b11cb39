"""A second opinion on collisions: dense samples in time, obstacles as clouds of points, arithmetic of its own.

It shares no distance function with the planner or the simulated world. What it asks the world for are facts: where
the axes are at an instant, the mount's angles, where the artefact stands. A standing capsule is a row of points
`SPACING_MM` apart with a radius; the probe is a point, two segments along Y and a box.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from agent.planning.job import Job
from simulators.world.world import World
from twin.arrays import Array

SPACING_MM = 1.0
"""The point nearest to a place on the axis is half of it away: at 4 mm distance that is 0.03 mm too far."""
STEP_MM = 0.75
"""Of the tip, or of the end of a turning bar, from one sample to the next."""
TURN_STEP_MM = 3.0
BLUR_MM = 0.05
"""What spacing, steps and the machine's own error may make of a clearance of nothing."""
CHUNK = 256


@dataclass(frozen=True)
class Cloud:
    """Points (n, 3) with radii (n,), and which body each belongs to. `ball[k]`: number of the ball, else -1."""

    points: Array
    radii: Array
    body: NDArray[np.intp]
    ball: NDArray[np.intp]
    names: tuple[str, ...]


@dataclass
class Seen:
    """`smallest_mm`: of all pairs but stylus on ball, where contact is meant."""

    samples: int = 0
    smallest_mm: float = math.inf
    collisions: list[str] = field(default_factory=list)


class Figures:
    """The probe's measures, by name as the settings have them."""

    def __init__(self, job: Job, overtravel_mm: float) -> None:
        probe = job.settings.probe
        self.tip, self.stem_radius, self.stem = probe.tip_radius_mm, probe.stem_radius_mm, probe.stem_length_mm
        self.body_radius, self.reach = probe.body_radius_mm, probe.reach_mm
        self.half, self.ram = probe.ram_half_width_mm, probe.ram_length_mm
        self.overtravel = overtravel_mm
        self.table_z = job.settings.mount.table_z_mm


class Judge:
    """Watches one run on `world`, slice by slice, before the world moves."""

    def __init__(self, world: World, job: Job) -> None:
        self._world = world
        self._job = job
        self._tool = np.array(world.controller.tool_offset)
        self.figures = Figures(job, world.scenario.settings.trigger.overtravel_mm)
        self._seen = Seen()
        self._tips: list[Array] = []
        self._cloud: Cloud | None = None
        self._standing: object = None

    def watch(self, before_s: float, after_s: float) -> None:
        """Everything that will be between two instants."""
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
        self._use_standing(before_s)
        self._tips.append(np.array([controller.displayed_at(t) for t in instants]) + self._tool)

    def seen(self) -> Seen:
        self._flush()
        return self._seen

    def _watch_turn(self, before_s: float, after_s: float) -> None:
        """The bar turns: where it is follows from the angles of the encoders alone."""
        self._flush()
        self._standing = None
        workpiece = self._world.workpiece
        angles = [workpiece.mount.angles_deg(t) for t in (before_s, after_s)]
        turned = math.radians(max(abs(b - a) for a, b in zip(*angles, strict=True)))
        count = max(1, math.ceil(turned * workpiece.sweep_radius_mm / TURN_STEP_MM))
        for instant in np.linspace(before_s, after_s, count + 1)[1:]:
            azimuth, elevation = workpiece.mount.angles_deg(float(instant))
            centre, rotation = pose(workpiece.location_mm, self._job.settings.mount.shaft_mm, azimuth, elevation)
            tip = np.array([self._world.controller.displayed_at(float(instant))]) + self._tool
            look(self._seen, tip, self._cloud_at(centre, rotation), self.figures)

    def _use_standing(self, instant_s: float) -> None:
        standing = self._world.workpiece.snapshot(instant_s)
        if standing is not self._standing:
            self._flush()
            self._standing = standing
            self._cloud = self._cloud_at(np.asarray(standing.pose.centre), np.asarray(standing.pose.rotation))

    def _cloud_at(self, centre: Array, rotation: Array) -> Cloud:
        return cloud_of(self._job, np.asarray(self._world.workpiece.location_mm), centre, rotation)

    def _flush(self) -> None:
        if self._tips and self._cloud is not None:
            look(self._seen, np.concatenate(self._tips), self._cloud, self.figures)
        self._tips = []


def pose(place: Array, shaft_mm: float, azimuth_deg: float, elevation_deg: float) -> tuple[Array, Array]:
    """Middle of the bar (3,), and the directions of the artefact's axes as columns (3, 3)."""
    a, e = math.radians(azimuth_deg), math.radians(elevation_deg)
    along = np.array([math.cos(e) * math.cos(a), math.cos(e) * math.sin(a), math.sin(e)])
    inward = np.array([-math.sin(a), math.cos(a), 0.0])
    return np.asarray(place) - shaft_mm * inward, np.column_stack([along, inward, np.cross(along, inward)])


def cloud_of(job: Job, place: Array, centre: Array, rotation: Array) -> Cloud:
    """All that stands, but for the table: balls, posts, bar, shaft, pedestal."""
    mount, balls = job.settings.mount, job.artefact.balls
    parts: list[tuple[str, Array, float, int]] = []
    for number, ball in enumerate(balls):
        middle = centre + rotation @ ball
        foot = centre + rotation @ np.array([ball[0], 0.0, 0.0])
        parts.append((f"ball {number}", middle[None], job.artefact.ball_radius_mm, number))
        parts.append((f"post {number}", _row(foot, middle), mount.post_radius_mm, -1))
    ends = [
        centre + rotation[:, 0] * (balls[:, 0].min() - mount.bar_overhang_mm),
        centre + rotation[:, 0] * (balls[:, 0].max() + mount.bar_overhang_mm),
    ]
    below, above = place.copy(), place.copy()
    below[2], above[2] = mount.table_z_mm, place[2] + mount.head_mm
    parts += [
        ("bar", _row(ends[0], ends[1]), mount.bar_radius_mm, -1),
        ("shaft", _row(place, centre), mount.shaft_radius_mm, -1),
        ("pedestal", _row(below, above), mount.pedestal_radius_mm, -1),
    ]
    counts = [len(points) for _, points, _, _ in parts]
    return Cloud(
        np.concatenate([points for _, points, _, _ in parts]),
        np.repeat([radius for _, _, radius, _ in parts], counts),
        np.repeat(np.arange(len(parts)), counts),
        np.repeat([ball for _, _, _, ball in parts], counts),
        tuple(name for name, _, _, _ in parts),
    )


def _row(start: Array, end: Array) -> Array:
    """(n, 3) points from `start` to `end`, both included."""
    count = max(1, math.ceil(float(np.linalg.norm(end - start)) / SPACING_MM)) + 1
    return np.asarray(start + np.linspace(0.0, 1.0, count)[:, None] * (end - start))


def look(seen: Seen, tips: Array, cloud: Cloud, figures: Figures) -> None:
    """Judge the tip centres `tips` (n, 3) among what stands."""
    for first in range(0, len(tips), CHUNK):
        part = tips[first : first + CHUNK]
        seen.samples += len(part)
        _table(seen, part, figures)
        near = _near(part, cloud, figures)
        if near.any():
            few = Cloud(cloud.points[near], cloud.radii[near], cloud.body[near], cloud.ball[near], cloud.names)
            _pairs(seen, part, few, figures)


def _near(tips: Array, cloud: Cloud, figures: Figures) -> NDArray[np.bool_]:
    """Points that any part of the probe could come near to; a broad box around all places."""
    low, high = tips.min(axis=0), tips.max(axis=0)
    room = max(figures.half, figures.body_radius, figures.tip) + 10.0
    low, high = low - room, high + room
    low[1] -= figures.reach + figures.ram
    wide = cloud.radii[:, None]
    return np.asarray(((cloud.points > low - wide) & (cloud.points < high + wide)).all(axis=1))


def _pairs(seen: Seen, tips: Array, cloud: Cloud, figures: Figures) -> None:
    gap = cloud.points[None] - tips[:, None]
    x, y, z = gap[..., 0], gap[..., 1], gap[..., 2]
    aside = x * x + z * z
    tip = np.sqrt(aside + y * y) - figures.tip - cloud.radii
    is_ball = cloud.ball >= 0
    stem = _from_segment(aside, y, -figures.stem, 0.0) - figures.stem_radius - cloud.radii
    touched = is_ball & (tip < BLUR_MM)
    stem_counts = np.where(touched, np.inf, stem)
    front, back = -figures.stem - figures.body_radius, -figures.reach + figures.body_radius
    body = _from_segment(aside, y, back, front) - figures.body_radius - cloud.radii
    beyond = np.maximum(np.abs(np.stack([x, z])) - figures.half, 0.0)
    behind = np.maximum(np.maximum(y + figures.reach, -figures.reach - figures.ram - y), 0.0)
    ram = np.sqrt((beyond**2).sum(axis=0) + behind**2) - cloud.radii
    tip_counts = np.where(is_ball, np.where(tip < -figures.overtravel, tip, np.inf), tip)
    for name, distance in (("tip", tip_counts), ("stem", stem_counts), ("probe body", body), ("ram", ram)):
        stylus_on_ball = is_ball if name == "stem" else np.zeros_like(is_ball)
        _note(seen, name, distance, stylus_on_ball, cloud)


def _from_segment(aside: Array, y: Array, low: float, high: float) -> Array:
    """Distance to the part of the tool's own axis between two places along it."""
    along = np.maximum(np.maximum(y - high, low - y), 0.0)
    return np.asarray(np.sqrt(aside + along * along))


def _note(seen: Seen, name: str, distance: Array, meant: NDArray[np.bool_], cloud: Cloud) -> None:
    place = int(distance.argmin())
    column = place % distance.shape[1]
    worst = float(distance.flat[place])
    pair = (name, cloud.names[int(cloud.body[column])])
    if worst < -BLUR_MM:
        seen.collisions.append(f"{pair[0]} with {pair[1]}, {-worst:.3f} mm deep")
    counted = np.where(meant, np.inf, distance)
    smallest = float(counted.min())
    seen.smallest_mm = min(seen.smallest_mm, smallest)


def _table(seen: Seen, tips: Array, figures: Figures) -> None:
    """The table's top is a plane for y >= 0, endless in X and towards the back."""
    ahead, low = tips[:, 1], tips[:, 2]
    for name, front, radius in (
        ("tip", 0.0, figures.tip),
        ("stem", 0.0, figures.stem_radius),
        ("probe body", -figures.stem - figures.body_radius, figures.body_radius),
    ):
        # The part of the body above the table; a rounded end that only leans over the edge is left to the next sample.
        above = np.where(ahead + front >= 0.0, low - radius - figures.table_z, np.inf)
        _note_table(seen, name, float(above.min()))
    ram = np.where(ahead - figures.reach >= 0.0, low - figures.half - figures.table_z, np.inf)
    _note_table(seen, "ram", float(ram.min()))


def _note_table(seen: Seen, name: str, clearance: float) -> None:
    if clearance < -BLUR_MM:
        seen.collisions.append(f"{name} with table, {-clearance:.3f} mm deep")
    seen.smallest_mm = min(seen.smallest_mm, clearance)
