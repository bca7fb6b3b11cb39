"""Path of the stylus tip through the steps of a plan. The plan is executed on an ideal machine, which has no errors and
only adds up the times of the steps.
"""

from __future__ import annotations

import re
from collections.abc import Generator
from contextlib import nullcontext, suppress
from dataclasses import dataclass
from typing import Any

from agent.errors import PlanRefused
from agent.execution.engine import Engine
from agent.execution.steps import STEPS_WITH_EFFECT, AskOperator, OrientTo, ReadPosition, Step, TouchTowards
from agent.planning.cycle_time import expected_plan
from agent.planning.ideal_machine import IdealMachine
from agent.planning.job import Job, Planner
from agent.planning.time_model import time_model
from drivers.errors import VolcalError
from drivers.roles import OperatorRequest, PlacementRequest
from twin.artefact.position_set import Position
from twin.collision.geometry import Point, point, translate_point

_BALL = re.compile(r"/ball-(\d+)")


@dataclass(frozen=True)
class Waypoint:
    """State of the ideal machine, on which a plan is executed, after a step of the plan.

    `tip_mm` is the tip centre in the workpiece frame. `ends_s` is the time in s since the start of the plan. `standing`
    contains the station of the artefact and the angles of the mount.
    """

    step: Step
    tip_mm: Point
    ends_s: float
    standing: Position

    @property
    def touches(self) -> bool:
        return isinstance(self.step, TouchTowards)

    @property
    def ball(self) -> int | None:
        """Number of the ball that the step of this waypoint measures, or None if the step belongs to no ball."""
        named = _BALL.search(self.step.key)
        return int(named.group(1)) if named else None


def walk_waypoints(job: Job, plan_of: Planner, refused: PlanRefused | None = None) -> tuple[Waypoint, ...]:
    """Return a waypoint (state after the step) for every step of the plan of `job` that moves or changes something, in
    the order of the steps. `plan_of` returns this plan.

    If the preflight refused the plan with the error `refused`, the waypoints end at the refused step. They end earlier
    if the ideal machine cannot carry out the plan up to that step.
    """
    walker = _Walker(job)
    last = refused.where.get("step") if refused else None
    with suppress(VolcalError) if refused else nullcontext():
        Engine(walker.actions, observer=walker.note).run(_up_to(expected_plan(plan_of(job)), last))
    return tuple(walker.waypoints)


def _up_to(plan: Generator[Step, Any, Any], last: str | None) -> Generator[Step, Any, None]:
    result: Any = None
    try:
        while True:
            step = plan.send(result)
            result = yield step
            if step.key == last:
                return
    except StopIteration:
        return
    finally:
        plan.close()


def standing_after(request: OperatorRequest, before: Position) -> Position:
    """Return the position of the artefact after the operator has fulfilled `request`; `before` is the one before."""
    if request.station is None:
        return before
    if isinstance(request, PlacementRequest):
        return Position(request.station, request.azimuth_deg, request.elevation_deg)
    return Position(request.station, before.azimuth_deg, before.elevation_deg)


class _Walker:
    """Recorder of the state of the ideal machine after each step."""

    def __init__(self, job: Job) -> None:
        machine = IdealMachine(job.layout, time_model(job.machine, job.settings.timing), job.start_mm, self._spent)
        self.actions = machine.actions()
        self.waypoints: list[Waypoint] = []
        self._offset = point(job.tool_offset_mm)
        self._elapsed_s = 0.0
        self._standing = Position(job.settings.stations.standing_at or 1, 0.0, 0.0)

    def note(self, step: Step, _: object) -> None:
        if not isinstance(step, STEPS_WITH_EFFECT):
            return
        if isinstance(step, OrientTo):
            self._standing = Position(step.station, step.azimuth_deg, step.elevation_deg)
        elif isinstance(step, AskOperator):
            self._standing = standing_after(step.request, self._standing)
        tip = translate_point(self.actions[ReadPosition](None), self._offset)
        self.waypoints.append(Waypoint(step, tip, self._elapsed_s, self._standing))

    def _spent(self, _: Step, motion_s: float, overhead_s: float) -> None:
        self._elapsed_s += motion_s + overhead_s
