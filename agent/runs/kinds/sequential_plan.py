"""Plan of a sequential calibration before it begins: the positions that its preflight walks, which must fit into the
slot together with the checks of the probe, the held-out positions and the proof."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import islice

from agent.errors import PlanRefused
from agent.planning.cycle_time import walk_plan
from agent.planning.design.sequential_candidates import MIN_POSITIONS, SequentialCandidates, standing_in
from agent.planning.job import Job
from agent.planning.preflight import Standing
from agent.runs.kinds.calibration import CalibrationTask
from agent.runs.kinds.sequential import SequentialEnd, SequentialTask, with_positions
from agent.runs.planned_run import PlannedRun
from twin.artefact.position_set import Position
from twin.units import S_PER_MIN


def plan_sequential(
    calibration: CalibrationTask,
    end: SequentialEnd,
    minutes_of: Callable[[SequentialTask], float],
    planned_run: Callable[[SequentialTask], PlannedRun],
) -> PlannedRun:
    """Return the run, planned by `planned_run` with a preflight, whose positions fit into the slot of `end`.
    `minutes_of` returns the machine minutes of the same plan on an ideal machine, which takes less time than a
    preflight.

    Raises PlanRefused if the slot is too short for the smallest number of positions, or if the artefact is placed by
    hand.
    """
    job = calibration.job
    if job.rules.placement is not None:
        raise PlanRefused(
            "a sequential calibration needs a mount: an artefact that is placed by hand is placed in listed positions",
            hint="calibrate without --sequential",
        )
    candidates = SequentialCandidates(job)
    checks, standing = _checks(job)
    room = end.time.left(checks)
    positions = candidates.planned(room, standing)
    found: tuple[Position, ...] = ()

    def task(measured: tuple[Position, ...]) -> SequentialTask:
        return SequentialTask(replace(calibration, job=with_positions(job, measured)), candidates, end, measured)

    # The minutes of the choice are estimates, those of the plan are not: their difference is used up, or saved.
    while len(positions) >= MIN_POSITIONS:
        left = end.time.left(minutes_of(task(positions)))
        if left < 0.0 and not found:
            positions = positions[:-1]
            continue
        if left < 0.0:
            break
        found, room = positions, room + left
        longer = candidates.planned(room, standing)
        if len(longer) <= len(positions):
            break
        positions = longer
    # The minutes of the preflight are the same but for rounding; it has the last word.
    while len(found) >= MIN_POSITIONS:
        planned = planned_run(task(found))
        if end.time.left(planned.preflight.machine_minutes) >= 0.0:
            return planned
        found = found[:-1]
    raise PlanRefused(
        f"the slot of {end.time.minutes:g} min is too short: {MIN_POSITIONS} positions, the held-out positions and the "
        f"proof take about {_shortest_minutes(candidates, checks, standing) + end.time.reserve:.0f} min",
        hint="give a longer slot, or hold out fewer positions (`verification.positions`, `verification.stations`)",
    )


def _checks(job: Job) -> tuple[float, Standing | None]:
    """Return the machine minutes of the checks of the probe, and the place of the artefact after them; None if it is
    not known."""
    prepared, steps = walk_plan(job, job.preparation_plan())
    standing = None if prepared.datum is None else standing_in(prepared.datum.position)
    return sum(timed.seconds for timed in steps) / S_PER_MIN, standing


def _shortest_minutes(candidates: SequentialCandidates, checks: float, standing: Standing | None) -> float:
    """Return the machine minutes of a run that measures the smallest number of positions."""
    minutes, first = checks, tuple(islice(candidates.sequence(standing), MIN_POSITIONS))
    for position in first:
        minutes += float(candidates.seconds(standing)[candidates.positions.index(position)]) / S_PER_MIN
        standing = standing_in(position)
    return minutes + (0.0 if standing is None else candidates.tail_minutes(standing.station))
