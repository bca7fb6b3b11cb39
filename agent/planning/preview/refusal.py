"""Refusal of a plan by the preflight, the simulated execution of the plan: the refused step, the two colliding bodies,
and the tip centre at the collision.
"""

from __future__ import annotations

import re
from collections.abc import Sequence

from agent.errors import PlanRefused
from agent.execution.steps import MoveTo, TouchTowards
from agent.planning.job import Job
from agent.planning.preview.artefact_placement import bodies_at
from agent.planning.preview.scene import Refusal
from agent.planning.preview.tip_path import Waypoint
from twin.collision.bodies import TIP, Body, ball_name
from twin.collision.collision import Hit, Scene
from twin.collision.geometry import Point, point, translate_point


def refusal_of(job: Job, refused: PlanRefused, waypoints: Sequence[Waypoint], visit: int) -> Refusal:
    """Return the refusal of the plan of `job`, as it is shown in the preview: the refused step, the two colliding
    bodies, and the tip centre at the collision.

    `refused` is the error raised by the preflight. `waypoints` contains the state of the machine after each step of the
    plan; the last one is that of the refused step. `visit` is the index of the visit (measurement of one position) to
    which the refused step belongs.
    """
    bodies: tuple[str, ...] = ()
    tip = translate_point(job.start_mm, point(job.tool_offset_mm))
    if waypoints:
        last, tip = waypoints[-1], waypoints[-1].tip_mm
        around = bodies_at(job, last.standing)
        moving = job.layout.probe.bodies(job.layout.frame)
        start = waypoints[-2].tip_mm if len(waypoints) > 1 else tip
        hit = _hit(Scene(moving, around), start, _goal(job, last), last)
        if hit is not None:
            tip = _between(start, _goal(job, last), hit.fraction)
        bodies = named_in(refused.message, moving, around) or ((hit.moving, hit.obstacle) if hit else ())
    return Refusal(str(refused), refused.where.get("step", ""), bodies, tip, visit)


def named_in(message: str, moving: Sequence[Body], standing: Sequence[Body]) -> tuple[str, ...]:
    """Return the names of the two colliding bodies that `message` contains: one of the bodies `moving` and one of the
    stationary bodies `standing`.

    The result is empty if `message` does not name one of each.
    """
    groups = [{body.name for body in group if _has(message, body.name)} for group in (moving, standing)]
    return tuple(max(names, key=len) for names in groups) if all(groups) else ()


def _has(message: str, name: str) -> bool:
    return re.search(rf"\b{re.escape(name)}\b", message) is not None


def _goal(job: Job, waypoint: Waypoint) -> Point:
    """Return the tip centre at the end of the waypoint's step; only moves and touches change it."""
    step = waypoint.step
    if isinstance(step, MoveTo | TouchTowards):
        return translate_point(step.target_mm, point(job.tool_offset_mm))
    return waypoint.tip_mm


def _hit(scene: Scene, start: Point, goal: Point, waypoint: Waypoint) -> Hit | None:
    meant = set()
    if waypoint.touches and waypoint.ball is not None:
        meant = {(TIP, ball_name(waypoint.ball)), ("stem", ball_name(waypoint.ball))}
    return scene.first_hit(start, goal, ignored=meant)


def _between(start: Point, end: Point, fraction: float) -> Point:
    return point(s + fraction * (e - s) for s, e in zip(start, end, strict=True))
