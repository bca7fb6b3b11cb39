"""Machine minutes of a run by phase. They are the minutes that the design of a position set, `volcal plan`, the page,
the forecast of a run and its report state.

The phases are the checks of the probe before the measurement, the measured positions, the held-out positions before
and after the new compensation table is active, and the changes of station.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

from agent.execution.steps import AskOperator, Step
from agent.planning.cycle_time import TimedStep, expected_plan, walk_plan
from agent.planning.job import Job, Planner
from agent.probing.homing_touches import PREFIX as HOMING
from agent.probing.preparation import PREFIX as CHECKS
from agent.probing.run_plan import position_key
from twin.artefact.position_set import Position
from twin.units import S_PER_MIN

PREPARATION, MEASURING, HELD_OUT, VERIFICATION = "preparation", "measuring", "held-out", "verification"
STATION_CHANGES = "station changes"
PHASES = (PREPARATION, MEASURING, HELD_OUT, VERIFICATION, STATION_CHANGES)
"""Phases of a run: probe check, qualification, reversal test and scatter of the homing; the position set; the held-out
positions before the table is written; the same positions with the new table; and the time of the operator and of parked
mounts."""

_VERIFY = "verify"


@dataclass(frozen=True)
class RunMinutes:
    """Machine time of a run in minutes. `by_phase` maps each name of `PHASES` to its minutes."""

    by_phase: Mapping[str, float]

    @property
    def total(self) -> float:
        return sum(self.by_phase.values())

    def as_json(self) -> dict[str, float]:
        return {phase: round(minutes, 3) for phase, minutes in self.by_phase.items()}

    @property
    def text(self) -> str:
        """Minutes of the phases that take time, as text for a person."""
        return ", ".join(f"{phase} {minutes:.1f}" for phase, minutes in self.by_phase.items() if minutes > 0.0)


def run_steps(job: Job, plan_of: Planner) -> list[TimedStep]:
    """Return the steps that take time of the expected branch of the plan of `job`, which `plan_of` returns."""
    return walk_plan(job, expected_plan(plan_of(job)))[1]


def run_minutes(job: Job, plan_of: Planner) -> RunMinutes:
    """Return the machine minutes of the run of `job` whose plan `plan_of` returns."""
    return minutes_by_phase(run_steps(job, plan_of), job.held_out)


def minutes_by_phase(steps: Iterable[TimedStep], held_out: Sequence[Position]) -> RunMinutes:
    """Return the machine minutes of `steps` by phase. `held_out` contains the held-out positions of the run."""
    keys = held_out_keys(held_out)
    minutes = dict.fromkeys(PHASES, 0.0)
    for timed in steps:
        minutes[phase_of(timed.step, keys)] += timed.seconds / S_PER_MIN
    return RunMinutes(minutes)


def held_out_keys(held_out: Sequence[Position]) -> frozenset[str]:
    """Return the keys of the held-out positions, as `phase_of` takes them."""
    return frozenset(position_key(position) for position in held_out)


def phase_of(step: Step, held_out: frozenset[str]) -> str:
    """Return the phase of a run to which `step` belongs. `held_out` contains the keys of the held-out positions."""
    prefix, *rest = step.key.split("/", 3)
    changes = "/change-" in step.key and any(part.startswith("change-") for part in rest[:2])
    if isinstance(step, AskOperator) or changes:
        return STATION_CHANGES
    if prefix in (CHECKS, HOMING):
        return PREPARATION
    if prefix == _VERIFY:
        return VERIFICATION
    return HELD_OUT if "/".join(rest[:2]) in held_out else MEASURING
