"""Planned run. It contains the job, the start conditions, the plan, and the result of its preflight. The machine has
not moved yet."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Protocol

from agent.errors import PlanRefused
from agent.execution.steps import Point, RunPlan, Step
from agent.planning.job import Job
from agent.planning.preflight import PreflightResult, run_preflight
from agent.planning.stand_ins import USUAL_STORE
from drivers.roles import HomingDirections, StoreLimits


@dataclass(frozen=True)
class StartConditions:
    """Conditions at the start of a run.

    Decisions that depend on the date, on earlier runs or on the axis positions are based on these values only. A
    resumed run therefore makes the same decisions as the interrupted run.

    `run` is the number of the run in the journal; only runs with lower numbers count as earlier. `at` is the UTC time
    in ISO 8601. `start_mm` contains the axis positions in mm. `store` contains the limits of the compensation store of
    the controller. `no_homing` is the reason why the controller cannot home the axes on command; it is empty if it can,
    and in a run that was begun before. `homing_directions` are the directions in which the axes search their switches.
    """

    run: int
    at: str
    start_mm: Point
    store: StoreLimits = field(default=USUAL_STORE)
    no_homing: str = ""
    homing_directions: HomingDirections = (0, 0, 0)


def never_too_late(_: Step, __: float) -> PlanRefused | None:
    """Return None: a run without a slot can be resumed at any time."""
    return None


@dataclass(frozen=True)
class PlannedRun:
    """Run that has passed its preflight. `job` holds the machine, the artefact, the settings and the positions that
    will be measured. `procedure` returns the plan that was walked by the preflight.

    `too_late` decides whether an interrupted run may still be resumed. It receives the first step of the resumed run
    that moves the machine, and the machine time in min since the run began, and returns an error if too little time is
    left.
    """

    job: Job
    kind: Kind
    start: StartConditions
    preflight: PreflightResult
    procedure: Callable[[], RunPlan]
    too_late: Callable[[Step, float], PlanRefused | None] = never_too_late


def plan_run(
    job: Job, kind: Kind, start: StartConditions, procedure: Callable[[], RunPlan], watch: Callable[[], None]
) -> PlannedRun:
    """Return the run of `job` whose plan is `procedure`, after a preflight that has walked this plan in every branch.
    Raises the same errors as `run_preflight`.
    """
    preflight = run_preflight(job, lambda _: procedure(), start.start_mm, watch)
    return PlannedRun(job, kind, start, preflight, procedure)


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
