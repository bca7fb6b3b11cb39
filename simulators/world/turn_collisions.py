"""Collisions while the mount turns: sampled in time, since a turning bar has no straight sweep."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from drivers.roles import MotionState
from simulators.world.controller import Controller
from simulators.world.turn_clearance import is_turn_clear
from simulators.world.workpiece import Workpiece
from twin.collision.bodies import TABLE
from twin.collision.collision import Scene
from twin.collision.geometry import Point, point, separation, sphere, swept_contact, translate_point

STEP_MM = 4.0
"""Nearer bodies are looked at again after so much motion: less than half the thinnest body that matters."""
_LOOKED_AT_MM = 150.0
_HERE: Point = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class TurnCrash:
    time_s: float
    moving: str
    obstacle: str


def first_turn_crash(workpiece: Workpiece, controller: Controller, start_s: float, end_s: float) -> TurnCrash | None:
    """First collision of probe and ram with the turning artefact in a span of time, if nothing intervenes."""
    if _stays_outside(workpiece, controller, start_s):
        return None
    speed = math.radians(workpiece.mount.max_speed_deg_per_s) * workpiece.sweep_radius_mm
    if controller.motion is MotionState.MOVING:
        speed += math.hypot(*controller.limits().rapid_mm_per_s)
    elif is_turn_clear(workpiece, _tip(controller, start_s), start_s, end_s):
        return None
    instant = start_s
    while True:
        tip = _tip(controller, instant)
        scene = workpiece.snapshot(instant).scene
        gap_mm = scene.clearance(tip, at_most=_LOOKED_AT_MM)
        pair = _touching(scene, tip) if gap_mm < 0.0 else None
        if pair is not None:
            return TurnCrash(instant, *pair)
        if instant >= end_s:
            return None
        instant = min(end_s, instant + max(gap_mm, STEP_MM) / speed)


def first_mount_collision(turning: Workpiece, other: Workpiece, start_s: float, end_s: float) -> TurnCrash | None:
    """First instant at which what turns meets what another mount carries, that turning too or not.

    From one look to the next passes only as much time as the fastest parts need for what lies between the bodies.
    """
    apart = np.hypot(*(turning.location_mm - other.location_mm)[:2])
    if apart > turning.sweep_radius_mm + other.sweep_radius_mm:
        return None
    speed = sum(math.radians(piece.mount.max_speed_deg_per_s) * piece.sweep_radius_mm for piece in (turning, other))
    instant = start_s
    while True:
        gap_mm, pair = _gap(Scene(turning.snapshot(instant).bodies, other.snapshot(instant).bodies))
        if gap_mm <= 0.0:
            return TurnCrash(instant, *pair)
        if instant >= end_s:
            return None
        instant = min(end_s, instant + max(gap_mm, STEP_MM) / speed)


def _gap(scene: Scene) -> tuple[float, tuple[str, str]]:
    """Smallest distance in mm of any two bodies, and their names; not looked for beyond `_LOOKED_AT_MM`.

    The table carries both.
    """
    smallest, pair = _LOOKED_AT_MM, ("", "")
    for i, j in scene.near_pairs(_HERE, _HERE, _LOOKED_AT_MM):
        body, obstacle = scene.moving[i], scene.obstacles[j]
        if TABLE not in (body.name, obstacle.name):
            distance = separation(body.shape, obstacle.shape)[0]
            if distance < smallest:
                smallest, pair = distance, (body.name, obstacle.name)
    return smallest, pair


def _stays_outside(workpiece: Workpiece, controller: Controller, start_s: float) -> bool:
    """Whether no body of the probe enters the ball that holds the artefact at all its angles."""
    reach = sphere(point(workpiece.location_mm), workpiece.sweep_radius_mm)
    tip, end = _tip(controller, start_s), _tip(controller, math.inf)
    displacement = (end[0] - tip[0], end[1] - tip[1], end[2] - tip[2])
    for body in workpiece.probe_bodies:
        here = body.shape.moved(tip)
        if separation(here, reach)[0] <= 0.0 or swept_contact(here, reach, displacement) is not None:
            return False
    return True


def _tip(controller: Controller, instant_s: float) -> Point:
    """Tip centre by what is displayed."""
    return translate_point(controller.displayed_at(instant_s), controller.tool_offset)


def _touching(scene: Scene, tip: Point) -> tuple[str, str] | None:
    """Names of the first two bodies that overlap with the tip centre at `tip`."""
    for i, j in scene.near_pairs(tip, tip):
        if separation(scene.moving[i].shape.moved(tip), scene.obstacles[j].shape)[0] < 0.0:
            return scene.moving[i].name, scene.obstacles[j].name
    return None
