"""Whether a position can be measured without a collision, and in how many minutes: its own plan, walked in thought.

The preflight rehearses the finished set with physics. A search looks at hundreds of positions, so here the straight
moves of the plan are checked against the bodies as they stand, which takes milliseconds.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, field

import numpy as np

from agent.execution.steps import MoveTo, Step, TouchTowards
from agent.job import Job
from agent.plans.ball import point
from agent.plans.measure import MeasuringOrder, measure_positions
from agent.time_model import S_PER_MIN
from agent.timing import walked
from twin.access import standing_scene
from twin.arrays import Array
from twin.bodies import TIP, ball_name
from twin.collision import Scene
from twin.geometry import Point, added
from twin.layout import Layout
from twin.position_set import Position

CLEARANCE_MM = 1.0
"""What every move keeps from everything: the mount never stands exactly where it is said to."""

_PREFIX = "vetted"
_BALL = re.compile(r"/ball-(\d+)")
_Key = tuple[float, float, float, float, bytes]


@dataclass(frozen=True, eq=False)
class _Walk:
    """A position's plan as walked: from `parked` with the mount at zero through all `steps`."""

    position: Position
    parked: Point
    steps: tuple[Step, ...]
    minutes: float


@dataclass(frozen=True, eq=False)
class Vetting:
    """Vets the positions of a job. Stations at the same depth and height differ only in what is within reach, so what
    was found at one of them holds at the others."""

    job: Job
    _walks: dict[_Key, _Walk] = field(default_factory=dict, init=False, repr=False)
    _hits: dict[_Key, str] = field(default_factory=dict, init=False, repr=False)

    def minutes(self, position: Position) -> float:
        """Machine minutes at a station where the mount stands already."""
        return self._walk(position).minutes

    def hit(self, position: Position) -> str:
        """What would hit what on the way, for people; empty where all is clear."""
        key = self._key(position)
        if key not in self._hits:
            walk = self._walk(position)
            self._hits[key] = _first_hit(walk, self._scene(walk.position), self.job.layout)
        return self._hits[key]

    def _key(self, position: Position) -> _Key:
        layout = self.job.layout
        place = layout.place(position.station)
        reached = layout.reachable(position, layout.nominal(position))
        return position.azimuth_deg, position.elevation_deg, float(place[1]), float(place[2]), reached.tobytes()

    def _walk(self, position: Position) -> _Walk:
        key = self._key(position)
        if key not in self._walks:
            self._walks[key] = self._walked(position)
        return self._walks[key]

    def _walked(self, position: Position) -> _Walk:
        job = self.job
        parked = point(job.rules.course.parked(job.layout.nominal(position).mean(axis=0), position.station))
        order = MeasuringOrder(_PREFIX, (position,), position.station)
        _, timed = walked(job, measure_positions(order, job.layout, job.rules), parked)
        minutes = sum(one.seconds for one in timed) / S_PER_MIN
        return _Walk(position, parked, tuple(one.step for one in timed), minutes)

    def _scene(self, position: Position) -> Scene:
        settings = self.job.settings
        _, scene = standing_scene(
            self.job.artefact,
            settings.probe,
            settings.mount,
            place_mm=self.job.layout.place(position.station),
            azimuth_rad=math.radians(position.azimuth_deg),
            elevation_rad=math.radians(position.elevation_deg),
        )
        return scene


def _first_hit(walk: _Walk, scene: Scene, layout: Layout) -> str:
    """Over every straight move. What touches stops at its own ball, and draws back from there."""
    balls, tool = layout.nominal(walk.position), point(layout.tool_offset_mm)
    at, touched = walk.parked, ""
    for step in walk.steps:
        if not isinstance(step, (MoveTo, TouchTowards)):
            continue
        target, own = step.target_mm, touched
        if isinstance(step, TouchTowards):
            number = int(_BALL.findall(step.key)[0])
            target, own = _contact(at, balls[number], layout.contact_mm), ball_name(number)
        meant = {(TIP, own), ("stem", own)} if own else set()
        hit = scene.first_hit(added(at, tool), added(target, tool), clearance_mm=CLEARANCE_MM, ignored=meant)
        if hit is not None:
            return f"{hit.moving} with {hit.obstacle}"
        at, touched = target, own if isinstance(step, TouchTowards) else ""
    return ""


def _contact(start: Point, centre: Array, contact_mm: float) -> Point:
    """Where the tip that comes from `start` meets the ball; touches go towards the centre."""
    away = np.array(start) - centre
    return point(centre + away * (contact_mm / np.linalg.norm(away)))
