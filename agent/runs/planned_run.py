"""Planned run: the job as it will be measured, its start conditions and its preflight, before anything moves."""

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
    """Conditions at the start of a run. Every decision by date, by earlier runs or by the position of the machine is
    made from these values, so that a resumed run decides the same again.

    `run`: its number in the journal; only runs with lower numbers count as earlier. `at`: UTC, ISO 8601. `start_mm`:
    axis positions.
    """

    run: int
    at: str
    start_mm: Point


@dataclass(frozen=True)
class PlannedRun:
    """Run that has passed its preflight. `job`: as it will be measured; `begin`: makes the run that carries it out."""

    job: Job
    kind: Kind
    start: StartConditions
    preflight: PreflightResult
    begin: Callable[[RunContext], GuardedRun]


class Kind(Protocol):
    """Kind of run. `name`: as the journal stores it."""

    @property
    def name(self) -> str: ...

    def plan(self, job: Job, start: StartConditions, watch: Callable[[], None]) -> PlannedRun:
        """Decide what will be measured and run its preflight from `start`; the same `start` gives the same plan.

        `watch` is called all the while and raises to interrupt; it decides nothing. Raises PlanRefused or UserError if
        the run cannot be carried out.
        """
        ...
