"""Planned run: the job that will be measured, its start conditions and its preflight, before anything moves."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

from agent.execution.steps import Point
from agent.planning.job import Job
from agent.planning.preflight import PreflightResult
from agent.runs.guarded_run import GuardedRun
from agent.runs.run_context import RunContext


@dataclass(frozen=True)
class StartConditions:
    """Conditions at the start of a run.

    All decisions that depend on the date, on earlier runs or on the position of the machine are based on these values,
    so that a resumed run makes the same decisions.

    `run` is the number of the run in the journal; only runs with lower numbers count as earlier. `at` is the UTC time
    in ISO 8601. `start_mm` contains the axis positions.
    """

    run: int
    at: str
    start_mm: Point


@dataclass(frozen=True)
class PlannedRun:
    """Run that has passed its preflight. `job` is the job that will be measured. `begin` creates the run object."""

    job: Job
    kind: Kind
    start: StartConditions
    preflight: PreflightResult
    begin: Callable[[RunContext], GuardedRun]


class Kind(Protocol):
    """Kind of run. `name` is its name in the journal."""

    @property
    def name(self) -> str: ...

    def plan(self, job: Job, start: StartConditions, watch: Callable[[], None]) -> PlannedRun:
        """Decide what will be measured and run its preflight with the start conditions `start`.

        The same start conditions give the same plan.

        `watch` is called repeatedly during planning and may raise an error to interrupt it; it does not influence the
        plan. Raises PlanRefused or UserError if the run cannot be carried out.
        """
        ...
