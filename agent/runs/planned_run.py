"""Planned run. It contains the job (machine, artefact, settings and positions to measure), the start conditions, and
the result of the preflight (simulated execution of the run). The machine has not moved yet."""

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

    Decisions that depend on the date, on earlier runs or on the axis positions are based on these values only. A
    resumed run therefore makes the same decisions as the interrupted run.

    `run` is the number of the run in the journal; only runs with lower numbers count as earlier. `at` is the UTC time
    in ISO 8601. `start_mm` contains the axis positions in mm.
    """

    run: int
    at: str
    start_mm: Point


@dataclass(frozen=True)
class PlannedRun:
    """Run that has passed its preflight (simulated execution). `job` holds the machine, the artefact, the settings and
    the positions that will be measured. `begin` is the function that creates the run object."""

    job: Job
    kind: Kind
    start: StartConditions
    preflight: PreflightResult
    begin: Callable[[RunContext], GuardedRun]


class Kind(Protocol):
    """Interface of a kind of run. `name` is the name of the kind in the journal."""

    @property
    def name(self) -> str: ...

    def plan(self, job: Job, start: StartConditions, watch: Callable[[], None]) -> PlannedRun:
        """Decide what will be measured, and simulate the complete run (preflight) with the start conditions `start`.

        Equal start conditions give equal plans. `watch` is called repeatedly during planning. It does not influence the
        plan, but it may raise an error, which interrupts the planning. Raises PlanRefused or UserError if the run
        cannot be carried out.
        """
        ...
