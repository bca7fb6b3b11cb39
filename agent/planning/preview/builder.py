"""Preview of a job: all positions, the path of the stylus tip through them, and the reason why the preflight refused
the plan, if it did.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import groupby

from agent.errors import PlanRefused
from agent.planning.job import Job, Planner
from agent.planning.preview.artefact_placement import artefact_placement_of, bodies_at
from agent.planning.preview.refusal import refusal_of
from agent.planning.preview.scene import ArtefactPlacement, PathPoint, Preview, Refusal, Visit
from agent.planning.preview.tip_path import Waypoint, walk_waypoints
from agent.probing.run_plan import position_key
from twin.artefact.position_set import MIN_BALLS, Position
from twin.collision.bodies import TABLE
from twin.collision.geometry import Box, point

MARGIN_MM = 200.0
"""Margin of the drawn part of the table around the bodies on it."""


def preview_of(job: Job, plan: Planner | Sequence[Waypoint], refused: PlanRefused | None = None) -> Preview:
    """Return the preview of the plan of `job`.

    `refused` is the error with which the preflight refused the plan, or None if the plan passed.
    `plan` is the function that returns the plan, or the path of the stylus tip if it has already been computed.
    """
    waypoints = walk_waypoints(job, plan, refused) if callable(plan) else plan
    positions = tuple(dict.fromkeys((*job.positions, *job.held_out)))
    held_out = set(job.held_out)
    placements = tuple(artefact_placement_of(job, position, held_out=position in held_out) for position in positions)
    walked = _walked(waypoints, positions)
    visits = (*walked, *_unvisited(placements, walked, refused))
    refusal = refusal_of(job, refused, waypoints, max(len(walked) - 1, 0)) if refused else None
    return Preview(
        machine=job.machine.name,
        artefact=job.artefact.name,
        position_set=job.settings.procedure.position_set,
        travel=_travel(job),
        table=_table(job),
        frame=job.layout.frame,
        probe=job.layout.probe.bodies(job.layout.frame),
        placements=placements,
        visits=visits,
        path=_path(waypoints, refusal),
        refusal=refusal,
    )


def _path(waypoints: Sequence[Waypoint], refusal: Refusal | None) -> tuple[PathPoint, ...]:
    """Return the path; if the plan was refused, the path ends where the two bodies collide."""
    path = [PathPoint(w.tip_mm, w.ends_s, w.ball, w.touches) for w in waypoints]
    if path and refusal:
        path[-1] = replace(path[-1], tip_mm=refusal.tip_mm, touch=False)
    return tuple(path)


def _walked(waypoints: Sequence[Waypoint], positions: Sequence[Position]) -> tuple[Visit, ...]:
    """Return one visit for each run of consecutive steps at the same position; steps between two positions, such as
    carrying, belong to the next one."""
    known = {position_key(position): number for number, position in enumerate(positions)}
    visits: list[Visit] = []
    index = 0
    for (phase, key), steps in groupby(waypoints, key=lambda waypoint: _phase_and_position(waypoint.step.key)):
        first, index = index, index + sum(1 for _ in steps)
        if key in known:
            begins = visits[-1].end if visits else 0
            visits.append(Visit(phase, known[key], min(begins, first), index))
    return tuple(visits)


def _phase_and_position(key: str) -> tuple[str, str]:
    """Return ``measure`` and ``station-1/az45-el0`` for ``measure/station-1/az45-el0/ball-03/touch-2``."""
    phase, *rest = key.split("/")
    return phase, "/".join(rest[:2])


def _unvisited(
    placements: Sequence[ArtefactPlacement], walked: Sequence[Visit], refused: PlanRefused | None
) -> list[Visit]:
    """Return a visit without waypoints for each position that is not measured, with the reason."""
    seen = {visit.placement for visit in walked}
    end = walked[-1].end if walked else 0
    visits = []
    for number, placement in enumerate(placements):
        if number in seen:
            continue
        if placement.reachable < MIN_BALLS:
            note = f"left out: {placement.reachable} of its balls can be reached, {MIN_BALLS} are needed"
        else:
            note = "not reached: the preflight was refused before" if refused else "not part of the plan"
        visits.append(Visit("", number, end, end, note))
    return visits


def _travel(job: Job) -> Box:
    low, high = zip(*job.machine.limits, strict=True)
    return Box(point(low + job.tool_offset_mm), point(high + job.tool_offset_mm))


def _table(job: Job) -> Box:
    """Return the part of the table under the travel and under all bodies on it."""
    travel = _travel(job)
    bodies = [body for station in job.stations for body in bodies_at(job, Position(station, 0.0, 0.0))]
    [table, *_] = [body.shape for body in bodies if body.name == TABLE]
    standing = [body.shape for body in bodies if body.name != TABLE]
    low = [min(travel.lower[i], *(shape.lower[i] for shape in standing)) - MARGIN_MM for i in range(2)]
    high = [max(travel.upper[i], *(shape.upper[i] for shape in standing)) + MARGIN_MM for i in range(2)]
    low = [max(value, end) for value, end in zip(low, table.lower, strict=False)]
    high = [min(value, end) for value, end in zip(high, table.upper, strict=False)]
    return Box((low[0], low[1], table.lower[2]), (high[0], high[1], table.upper[2]))
