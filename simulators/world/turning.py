"""Collisions while the mount turns: sampled in time, since a turning bar has no straight sweep."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

from simulators.world.controller import Controller
from simulators.world.mount import MountPhysics
from simulators.world.workpiece import Workpiece
from twin.collision import Scene
from twin.geometry import Point, added, point, separation, sphere, swept_contact

STEP_MM = 4.0
"""A body moves about this far from one sample to the next: less than half the thinnest body that matters."""
STEP_S = 0.02


@dataclass(frozen=True)
class TurnCrash:
    time_s: float
    moving: str
    obstacle: str


def first_turn_crash(workpiece: Workpiece, controller: Controller, start_s: float, end_s: float) -> TurnCrash | None:
    """First collision of probe and ram with the turning artefact in a span of time, if nothing intervenes."""
    if _stays_outside(workpiece, controller, start_s):
        return None
    for instant in _instants(workpiece.mount, workpiece.sweep_radius_mm, start_s, end_s):
        tip = added(controller.displayed_at(instant), controller.tool_offset)
        pair = _touching(workpiece.standing(instant).scene, tip)
        if pair is not None:
            return TurnCrash(instant, *pair)
    return None


def _stays_outside(workpiece: Workpiece, controller: Controller, start_s: float) -> bool:
    """Whether no body of the probe enters the ball that holds the artefact at all its angles."""
    reach = sphere(point(workpiece.place_mm), workpiece.sweep_radius_mm)
    tip = added(controller.displayed_at(start_s), controller.tool_offset)
    end = added(controller.displayed_at(math.inf), controller.tool_offset)
    way = (end[0] - tip[0], end[1] - tip[1], end[2] - tip[2])
    for body in workpiece.probe_bodies:
        here = body.shape.moved(tip)
        if separation(here, reach)[0] <= 0.0 or swept_contact(here, reach, way) is not None:
            return False
    return True


def _instants(mount: MountPhysics, radius_mm: float, start_s: float, end_s: float) -> Iterator[float]:
    fastest = mount.fastest_deg_per_s
    step = min(STEP_S, STEP_MM / (math.radians(fastest) * radius_mm))
    count = math.ceil((end_s - start_s) / step)
    return (start_s + (end_s - start_s) * i / count for i in range(1, count + 1))


def _touching(scene: Scene, tip: Point) -> tuple[str, str] | None:
    """Names of the first two bodies that overlap with the tip centre at `tip`."""
    for i, j in scene.near(tip, tip):
        if separation(scene.moving[i].shape.moved(tip), scene.obstacles[j].shape)[0] < 0.0:
            return scene.moving[i].name, scene.obstacles[j].name
    return None
