"""Feasibility of measuring a position. The module checks the plan for measuring the position for collisions, and
computes the machine minutes that the plan takes.

A search for a position set evaluates hundreds of positions. This module therefore checks only the straight moves of the
plan against the bodies of artefact and mount at their nominal locations, which takes milliseconds per position. The
position set that is found is checked by a preflight, which simulates the physics.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from agent.execution.steps import MoveTo, TouchTowards
from agent.planning.cycle_time import position_minutes, walk_plan
from agent.planning.job import Job
from agent.planning.measuring_order import AT_REST_DEG
from agent.planning.time_model import TimeModel, time_model
from agent.probing.ball import point
from agent.probing.run_plan import MeasuringOrder, measure_positions
from twin.arrays import Array
from twin.artefact.position_set import Position
from twin.collision.accessibility import AT_CONTACT_MM, measuring_scene
from twin.collision.bodies import TIP, ball_name
from twin.collision.collision import Scene
from twin.collision.geometry import Point, translate_point
from twin.design.candidates import CandidatePositions, Indices
from twin.design.measuring_cost import MeasuringCosts
from twin.design.search import ExchangeSearch
from twin.units import S_PER_MIN

CLEARANCE_MM = 1.0
"""Minimum clearance of every move from all bodies, because a mount is never exactly at its nominal location."""

_PREFIX = "vetted"
_TIMED = 40  # positions from whose minutes those of all others are estimated
_BALL = re.compile(r"/ball-(\d+)")
_Key = tuple[float, float, float, Point, bytes, int]


def timed_among(count: int, timed: int | None = None) -> Indices:
    """Return the indices of those of `count` positions whose minutes are computed, at most `timed` or `_TIMED`, while
    those of the others follow from them."""
    return np.unique(np.linspace(0, count - 1, min(timed or _TIMED, count)).round().astype(np.intp))


def line_over_balls(balls: Indices, timed: Indices, minutes: Array) -> Array:
    """Return the straight line (N,) over the numbers of measured balls `balls` (N,) that fits best to the `minutes`
    (k,) of the positions with the indices `timed` (k,)."""
    line = np.stack((np.ones(len(balls)), balls), axis=1)
    return np.asarray(line @ np.linalg.lstsq(line[timed], minutes, rcond=None)[0])


@dataclass(frozen=True, eq=False)
class FeasibilityCheck:
    """Check whether the positions of a job can be measured without a collision, and how long each takes.

    Results are cached. For the same orientation, a result at one station is used at another station too, if the
    stations have the same artefact, the same Y and Z, the same distance to their park locations, and the same balls
    within reach. `timed` is the number of positions from whose minutes those of the others are estimated;
    if it is None, it is `_TIMED`.
    """

    job: Job
    timed: int | None = None
    _minutes: dict[_Key, float] = field(default_factory=dict, init=False, repr=False)
    _hits: dict[_Key, str] = field(default_factory=dict, init=False, repr=False)

    def minutes(self, position: Position) -> float:
        """Return the machine minutes for measuring `position`, if the artefact already stands at the station of this
        position.
        """
        key = self._key(position)
        if key not in self._minutes:
            self._minutes[key] = position_minutes(self.job, position)
        return self._minutes[key]

    def estimated_minutes(self, positions: Sequence[Position], balls: Indices) -> Array:
        """Return the approximate machine minutes (N,) for measuring each of N positions.

        The minutes of `timed` of the positions are computed. Without the turn of the mount, they are nearly a straight
        line over the number of balls; this line gives the minutes of all other positions. `balls` (N,) contains the
        number of measured balls of each position.
        """
        turns = np.array([self.turn_minutes(position) for position in positions])
        timed = timed_among(len(positions), self.timed)
        exact = np.array([self.minutes(positions[index]) for index in timed])
        own = exact - turns[timed]
        minutes = np.maximum(line_over_balls(balls, timed, own), own.min()) + turns
        minutes[timed] = exact
        return np.asarray(minutes)

    def search_among(
        self,
        candidates: CandidatePositions,
        *,
        standing_at: int | None,
        carry_minutes: float = 0.0,
        estimate_minutes: bool = False,
    ) -> ExchangeSearch:
        """Return the search for the best of `candidates` that can be measured, with the time of each, which is only
        approximate if `estimate_minutes` is True. The artefact stands at the station `standing_at` first, and a change
        of station takes `carry_minutes`."""
        positions = candidates.positions
        costs = MeasuringCosts(
            minutes=self.estimated_minutes(positions, candidates.balls)
            if estimate_minutes
            else np.array([self.minutes(position) for position in positions]),
            stations=np.array([position.station for position in positions]),
            carry_minutes=carry_minutes,
            standing_at=standing_at,
        )
        return ExchangeSearch(candidates, costs, lambda index: not self.hit(positions[index]))

    def hit(self, position: Position) -> str:
        """Return a text that names the two bodies of the first collision in the plan for measuring `position`.

        The text is empty if there is no collision.
        """
        key = self._key(position)
        if key not in self._hits:
            self._hits[key] = self._first_hit(position)
        return self._hits[key]

    def turn_minutes(self, position: Position) -> float:
        """Return the minutes in which the mount turns from rest to the angles of `position`."""
        return self._times.turn_s(AT_REST_DEG, (position.azimuth_deg, position.elevation_deg)) / S_PER_MIN

    @cached_property
    def _times(self) -> TimeModel:
        return time_model(self.job.machine, self.job.settings.timing)

    def _key(self, position: Position) -> _Key:
        layout = self.job.layout
        location = layout.location(position.station)
        park = self.job.rules.retreat.park_mm[position.station] - float(location[layout.station_axis])
        reached = layout.reachable(position, layout.nominal(position))
        artefact = layout.first_ball(position.station)  # each artefact starts at a ball number of its own
        return (
            position.azimuth_deg,
            position.elevation_deg,
            park,
            layout.across_stations(location),
            reached.tobytes(),
            artefact,
        )

    def _first_hit(self, position: Position) -> str:
        """Return the two bodies of the first collision of a straight move, as text. A touch ends at its own ball, and
        the next move starts there."""
        job, scene = self.job, self._scene(position)
        resting_mm = job.layout.contact_mm - job.layout.overtravel_mm
        balls, tool = job.layout.nominal(position), point(job.tool_offset_mm)
        at, touched = point(job.rules.retreat.park_location(balls.mean(axis=0), position.station)), ""
        order = MeasuringOrder(_PREFIX, (position,), position.station)
        _, timed = walk_plan(job, measure_positions(order, job.layout, job.rules), at)
        for step in (one.step for one in timed):
            if not isinstance(step, (MoveTo, TouchTowards)):
                continue
            target, own = step.target_mm, touched
            if isinstance(step, TouchTowards):
                number = int(_BALL.findall(step.key)[0])
                target, own = _at_rest(at, balls[number], resting_mm), ball_name(number)
            meant = {(TIP, own), ("stem", own)} if own else set()
            apart_mm = AT_CONTACT_MM if own else CLEARANCE_MM
            hit = scene.first_hit(
                translate_point(at, tool), translate_point(target, tool), clearance_mm=apart_mm, ignored=meant
            )
            if hit is not None:
                return f"{hit.moving} with {hit.obstacle}"
            at, touched = target, own if isinstance(step, TouchTowards) else ""
        return ""

    def _scene(self, position: Position) -> Scene:
        settings = self.job.settings
        _, scene = measuring_scene(
            self.job.layout.artefact_at(position.station),
            self.job.layout.probe,
            settings.mount,
            frame=self.job.layout.frame,
            location_mm=self.job.layout.location(position.station),
            azimuth_rad=math.radians(position.azimuth_deg),
            elevation_rad=math.radians(position.elevation_deg),
        )
        return scene


def _at_rest(start: Point, centre: Array, resting_mm: float) -> Point:
    """Return the tip centre after a touch from `start` towards the centre of the ball."""
    away = np.array(start) - centre
    return point(centre + away * (resting_mm / np.linalg.norm(away)))
