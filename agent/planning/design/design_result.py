"""Finished design of a position set.

The positions are selected from the candidates, put in measuring order, timed with the plan of the run, and checked by a
preflight. Designs for several measuring variants (tools, touches per ball, bars) are compared, and the one that meets
the goal best is marked.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial

from agent.errors import PlanRefused
from agent.files import translated
from agent.planning.design.design_problem import DesignProblem
from agent.planning.design.pareto_front import FrontPoint, front_of
from agent.planning.design.variants import Variant
from agent.planning.job import Job, Planner
from agent.planning.run_minutes import RunMinutes
from agent.probing.run_plan import position_key
from drivers.errors import ConfigurationError, InputError, UserError
from twin.arrays import Array
from twin.artefact.position_set import Position
from twin.design.candidates import CandidatePositions
from twin.design.goals import Goal, TargetErrorGoal, TimeSlotGoal
from twin.design.held_out import most_informative_groups
from twin.design.search import ExchangeSearch
from twin.design.station_places import StationPlaces
from twin.design.valuation import Valuation
from twin.identification.instruments.readings import InstrumentReadings
from twin.machine.volumetric import evaluation_grid

Say = Callable[[str], None]
Prove = Callable[[Job], object]
"""Function that carries out the preflight of a calibration of a job. Raises PlanRefused if it refuses the plan."""

_MAX_ATTEMPTS = 12
_SLACK_MIN = 0.01
_MAX_EXTENSIONS = 4
_ORIENTATIONS = 2
_MAX_ROUNDS = 3  # of places and positions in turn; each of the shipped cases ends after one or two
_MARGIN = 1.3  # factor on the excess over a slot, so that one more search usually suffices


@dataclass(frozen=True, eq=False)
class DesignResult:
    """Finished design of a position set.

    `chosen` contains the indices of the selected positions among the candidates of `problem`. `positions` contains the
    selected positions in measuring order. `minutes` is the machine time in minutes of the whole run, checks and proof
    included, as `volcal plan` states it for this set.
    `valuation` is the expected volumetric error before and after compensation. `balls` is the number of ball
    measurements. `held_out` contains the positions for verification, if they were requested. `preflight_passed` is True
    if a preflight was carried out and passed.
    """

    problem: DesignProblem
    chosen: tuple[int, ...]
    positions: tuple[Position, ...]
    minutes: float
    valuation: Valuation
    balls: int
    held_out: tuple[Position, ...]
    preflight_passed: bool

    @cached_property
    def minutes_by_phase(self) -> RunMinutes:
        """Machine minutes of the run by phase."""
        return self.problem.minutes_by_phase(self.positions, self.held_out)

    @cached_property
    def front(self) -> tuple[FrontPoint, ...]:
        """Pareto front of the expected volumetric error after compensation against machine minutes. It includes this
        design.
        """
        return front_of(self.problem.search, self.chosen, self.minutes)

    @property
    def touches(self) -> int:
        return self.balls * self.problem.job.settings.procedure.touches_per_ball


def find_design(
    problem: DesignProblem,
    goal: Goal,
    *,
    verify: bool,
    prove: Prove | None,
    say: Say,
    start: Sequence[Position] = (),
) -> DesignResult:
    """Return the best position set found for the goal `goal` among the candidates of `problem`.

    If the positions `start` are given and the goal is a time slot, they are improved instead of a new set being grown.
    `prove` carries out the preflight of the set found; if it is None, there is none. If the preflight refuses a
    position, the position is excluded and the search is repeated. If `verify` is True, held-out
    positions for the verification are selected too. `say` is called with the name of the current activity.

    Raises InputError if the goal cannot be reached. Raises ConfigurationError if no position is within reach or if the
    preflight refuses the set found in every attempt. Raises PlanRefused if the preflight refuses a step that belongs to
    no selected position.
    """
    found = _unproved(problem, goal, verify=verify, say=say, start=start)
    return found if prove is None else proved_design(found, goal, verify=verify, prove=prove, say=say)


def _unproved(
    problem: DesignProblem, goal: Goal, *, verify: bool, say: Say, start: Sequence[Position] = ()
) -> DesignResult:
    say("candidates")
    with translated(ConfigurationError, key="stations.places_mm"):
        candidates = problem.candidates
    say("minutes of the candidates")
    search = problem.search
    say("search")
    draft = _selected(problem, search, goal, _indices(candidates, start), verify=verify)
    return DesignResult(
        problem=problem,
        chosen=draft.chosen,
        positions=draft.positions,
        minutes=draft.minutes,
        valuation=Valuation(candidates.before, candidates.vce(draft.chosen)),
        balls=int(sum(candidates.balls[list(draft.chosen)])),
        held_out=draft.held_out,
        preflight_passed=False,
    )


def proved_design(found: DesignResult, goal: Goal, *, verify: bool, prove: Prove, say: Say) -> DesignResult:
    """Return the design `found` if it passes its preflight, or one found without the positions that are refused."""
    for _ in range(_MAX_ATTEMPTS):
        say("preflight")
        refused = _refused(found.problem, found.positions, found.held_out, prove)
        if refused is None:
            return replace(found, preflight_passed=True)
        found = _unproved(found.problem.refusing(refused), goal, verify=verify, say=say)
    raise ConfigurationError(
        f"the preflight refused a position of each of {_MAX_ATTEMPTS} designs",
        hint="`volcal plan` shows the obstacle",
    )


@dataclass(frozen=True, eq=False)
class _Draft:
    """Selected candidates `chosen`, the positions in measuring order, the held-out positions that the design selects,
    and the minutes of the whole run. For a time slot, `slot_minutes` is the slot that was given to the search."""

    chosen: tuple[int, ...]
    positions: tuple[Position, ...]
    held_out: tuple[Position, ...]
    minutes: float
    slot_minutes: float = math.nan


def _indices(candidates: CandidatePositions, positions: Sequence[Position]) -> tuple[int, ...]:
    """Return the candidates with the orientations of `positions`, whichever of their balls are measured."""
    known = {replace(one, balls=None): index for index, one in enumerate(candidates.positions)}
    return tuple(known[whole] for whole in (replace(one, balls=None) for one in positions) if whole in known)


def _selected(
    problem: DesignProblem, search: ExchangeSearch, goal: Goal, start: Sequence[int], *, verify: bool
) -> _Draft:
    """Return a selection that reaches the goal with the minutes of the whole run.

    The search adds up approximate minutes of single positions and those that a run takes anyway, but a time slot
    applies to the whole run. The slot given to the search is therefore shortened until the run fits, and extended as
    long as time is left that improves the selection.
    """
    if not isinstance(goal, TimeSlotGoal):
        return _drafted(problem, search, partial(goal.select, search), verify=verify)
    draft = _fitting(problem, search, goal, goal.minutes, start, verify=verify)
    for _ in range(_MAX_EXTENSIONS):
        spare = goal.minutes - draft.minutes
        if spare <= search.costs.minutes.min():
            break
        fuller = _fitting(problem, search, goal, draft.slot_minutes + spare, draft.chosen, verify=verify)
        if search.candidates.vce(fuller.chosen).aligned_mm >= search.candidates.vce(draft.chosen).aligned_mm:
            break
        draft = fuller
    return draft


def _fitting(
    problem: DesignProblem,
    search: ExchangeSearch,
    asked: TimeSlotGoal,
    minutes: float,
    start: Sequence[int],
    *,
    verify: bool,
) -> _Draft:
    """Return a draft whose run fits the slot `asked`. `minutes` is the slot that is given to the search first, and
    `start` the selection that it improves; if it is empty, there is none yet."""
    shortest = math.inf
    while True:
        try:
            draft = _drafted(problem, search, partial(TimeSlotGoal(minutes).select, search, start), verify=verify)
        except InputError:
            if shortest == math.inf:
                raise
            raise InputError(
                f"{asked.minutes:g} min are too short: the shortest run that was found takes {shortest:.1f} min, its "
                "checks and its proof included",
                hint="allow a longer slot, or use fewer touches or fewer balls",
                key="slot",
            ) from None
        over = draft.minutes - asked.minutes
        if over <= 0.0:
            return replace(draft, slot_minutes=minutes)
        shortest = min(shortest, draft.minutes)
        start = draft.chosen
        minutes -= _MARGIN * over + _SLACK_MIN


def _drafted(
    problem: DesignProblem, search: ExchangeSearch, select: Callable[[], tuple[int, ...]], *, verify: bool
) -> _Draft:
    with translated(InputError):
        chosen = select()
    positions = problem.in_order([search.candidates.positions[index] for index in chosen])
    held_out = _held_out(problem, search.candidates, chosen) if verify else ()
    return _Draft(chosen, positions, held_out, problem.minutes(positions, held_out))


def _held_out(problem: DesignProblem, candidates: CandidatePositions, chosen: Sequence[int]) -> tuple[Position, ...]:
    """Return the most informative orientations at every verified station: as many as the settings list, or two if they
    list none."""
    job = problem.job
    groups: dict[tuple[float, float], list[int]] = {}
    for index, position in enumerate(candidates.positions):
        if position.station in job.verified_stations and position.tool is None and problem.passes(position):
            groups.setdefault((position.azimuth_deg, position.elevation_deg), []).append(index)
    whole = [group for group in groups.values() if len(group) == len(job.verified_stations)]
    listed = job.settings.verification.positions_deg
    count = _ORIENTATIONS if listed is None else len(listed)
    with translated(InputError, key="--verify-set"):
        telling = most_informative_groups(candidates, chosen, whole, count)
    found = [candidates.positions[index] for group in telling for index in group]
    return tuple(sorted(found, key=lambda position: position.station))


def _refused(
    problem: DesignProblem, positions: Sequence[Position], held_out: Sequence[Position], prove: Prove
) -> Position | None:
    """Return the position in `positions` at which the preflight refuses the plan, or None if the preflight passes.
    Raises PlanRefused if the preflight refuses a step that belongs to none of them."""
    for job in problem.runs(positions, held_out):
        try:
            prove(job)
        except PlanRefused as error:
            step = error.where.get("step", "")
            for position in positions:
                if f"/{position_key(position)}/" in step:
                    return position
            raise
    return None


@dataclass(frozen=True, eq=False)
class VariantDesign:
    """Position set designed for one measuring variant.

    If the goal of the design cannot be reached with this variant, `design` is None and `reason` states the cause.
    `best` is True for the best of the designs compared.
    """

    variant: Variant
    design: DesignResult | None
    reason: str = ""
    best: bool = False

    @property
    def result(self) -> DesignResult:
        """Position set designed for this variant. Raises ValueError with the text `reason` if `design` is None."""
        if self.design is None:
            raise ValueError(self.reason)
        return self.design


def with_free_stations(
    choice: VariantDesign, goal: Goal, *, verify: bool, prove: Prove, say: Say
) -> tuple[VariantDesign, Mapping[int, Array]]:
    """Return a better design if the stations may stand anywhere along their axis, and the place (3,) in mm of each
    station. It is `choice` if no better one is found.

    The places are improved for the set that was found, and the set for the new places, in turn. The station at which
    the artefact stands is not moved.
    """
    best = choice
    for _ in range(_MAX_ROUNDS):
        say("places of the stations")
        found = best.result
        moved = found.problem.with_places(_better_places(found))
        start = found.positions if isinstance(goal, TimeSlotGoal) else ()
        try:
            other = find_design(moved, goal, verify=verify, prove=None, say=say, start=start)
        except UserError:  # the goal cannot be reached from there
            break
        if _rank(other, goal) >= _rank(found, goal):
            break
        best = replace(best, design=other)
    if best is not choice and not best.variant.made_up:
        best = _proved_if_better(best, choice, goal, verify=verify, prove=prove, say=say)
    return best, best.result.problem.job.layout.locations_mm


def _proved_if_better(
    moved: VariantDesign, choice: VariantDesign, goal: Goal, *, verify: bool, prove: Prove, say: Say
) -> VariantDesign:
    """Return the proved design of `moved`, or `choice` if its preflight leaves none that is better than `choice`."""
    try:
        proved = proved_design(moved.result, goal, verify=verify, prove=prove, say=say)
    except (UserError, PlanRefused):
        return choice
    return replace(moved, design=proved) if _rank(proved, goal) < _rank(choice.result, goal) else choice


def _better_places(found: DesignResult) -> Mapping[int, Array]:
    problem, job = found.problem, found.problem.job
    at = job.settings.stations.standing_at
    return StationPlaces(
        procedure=problem.procedure,
        positions=found.positions,
        family=job.machine.family,
        options=problem.options,
        grid=evaluation_grid(job.machine.model.ranges_mm),
        tool_offset=job.tool_offset_mm,
        travel_mm=job.machine.limits[job.layout.station_axis],
        kept=() if at is None else (at,),
    ).improved()


def refuse_fixed_stations(job: Job) -> None:
    """Raise InputError if the stations of `job` cannot stand elsewhere because each of them has a mount of its own."""
    if job.rules.change.own_mounts:
        raise InputError(
            "the stations are fixed: each of them has a mount of its own",
            hint="leave --free-stations out, or change stations.places_mm and compare the designs",
            key="--free-stations",
        )


def compare_variants(
    variants: Sequence[Variant],
    goal: Goal,
    grid_deg: float,
    plan_of: Planner,
    *,
    verify: bool,
    prove: Prove,
    say: Say,
    instruments: tuple[InstrumentReadings, ...] = (),
) -> list[VariantDesign]:
    """Return a designed position set for each variant, and mark the best design. `plan_of` returns the plan of the run
    for which the positions are chosen, and `prove` carries out its preflight. `instruments` are planned readings that
    will be evaluated with the balls.

    If `goal` is a target error, the best design is the one that takes the least machine time. For any other goal, the
    best design is the one with the smallest expected volumetric error after compensation (VCE). If no variant reaches
    the goal, the error raised for the first variant is raised.
    """
    choices: list[VariantDesign] = []
    errors: dict[Variant, UserError] = {}

    def designed(variant: Variant, design: Callable[[], DesignResult]) -> VariantDesign:
        try:
            return VariantDesign(variant, design())
        except UserError as error:
            errors[variant] = error
            return VariantDesign(variant, None, error.message)

    for variant in variants:
        problem = DesignProblem(variant.jobs, grid_deg, plan_of, variant.ball_share, instruments=instruments)
        choices.append(designed(variant, partial(_unproved, problem, goal, verify=verify, say=say)))
    while True:  # only the best is proved: a preflight takes as long as a search
        reached = [number for number, choice in enumerate(choices) if choice.design is not None]
        if not reached:
            raise errors[variants[0]]
        best = min(reached, key=lambda number: _rank(choices[number].result, goal))
        found = choices[best].result
        if choices[best].variant.made_up or found.preflight_passed:
            break
        proof = partial(proved_design, found, goal, verify=verify, prove=prove, say=say)
        choices[best] = designed(choices[best].variant, proof)
    choices[best] = replace(choices[best], best=True)
    return choices


def _rank(found: DesignResult, goal: Goal) -> tuple[float, float]:
    vce, minutes = found.valuation.after.aligned_mm, found.minutes
    return (minutes, vce) if isinstance(goal, TargetErrorGoal) else (vce, minutes)
