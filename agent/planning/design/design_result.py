"""A finished design: positions chosen, ordered, timed by the run's own plan and proved by a preflight."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

from agent.errors import PlanRefused
from agent.files import translated
from agent.planning.design.design_problem import DesignProblem
from agent.planning.design.pareto_front import FrontPoint, front_of
from agent.planning.preflight import run_preflight
from agent.probing.run_plan import position_key
from drivers.errors import ConfigurationError, InputError
from twin.artefact.position_set import Position
from twin.design.candidates import CandidatePositions
from twin.design.goals import Goal, TimeSlotGoal
from twin.design.held_out import most_informative_groups
from twin.design.search import ExchangeSearch
from twin.design.valuation import Valuation

Say = Callable[[str], None]

_MOST_TRIES = 12
_LITTLE_MIN = 0.01
_MARGIN = 1.3  # beyond what a slot was exceeded by, so that one more search does as a rule


@dataclass(frozen=True, eq=False)
class DesignResult:
    """`chosen` of the setting's candidates, as `positions` in the order of measuring; `minutes` by the run's own plan;
    `held_out`: positions for the proof, if asked for; `preflight_passed`: a preflight was run and passed."""

    setting: DesignProblem
    chosen: tuple[int, ...]
    positions: tuple[Position, ...]
    minutes: float
    valuation: Valuation
    balls: int
    held_out: tuple[Position, ...]
    preflight_passed: bool

    @cached_property
    def front(self) -> tuple[FrontPoint, ...]:
        """What every further minute buys."""
        return front_of(self.setting.search, self.chosen, self.minutes)

    @property
    def touches(self) -> int:
        return self.balls * self.setting.job.settings.procedure.touches_per_ball


def find_design(setting: DesignProblem, goal: Goal, *, verify: bool, with_preflight: bool, say: Say) -> DesignResult:
    """The best set found for `goal`. A position that the preflight refuses is left out and all is done again.

    Raises InputError for a goal that cannot be reached, ConfigurationError for settings that offer nothing.
    """
    for _ in range(_MOST_TRIES):
        say("candidates")
        with translated(ConfigurationError, key="stations.places_mm"):
            candidates = setting.candidates
        say("minutes of every candidate")
        search = setting.search
        say("search")
        chosen = _within(setting, search, goal)
        held_out = _held_out(setting, candidates, chosen) if verify else ()
        positions = setting.in_order([candidates.positions[index] for index in chosen])
        if with_preflight:
            say("preflight")
            refused = _refused(setting, positions, held_out)
            if refused is not None:
                setting = setting.refusing(refused)
                continue
        return DesignResult(
            setting=setting,
            chosen=chosen,
            positions=positions,
            minutes=setting.minutes(positions),
            valuation=Valuation(candidates.vce([]), candidates.vce(chosen)),
            balls=int(sum(candidates.balls[list(chosen)])),
            held_out=held_out,
            preflight_passed=with_preflight,
        )
    raise ConfigurationError(
        f"the preflight refused a position of each of {_MOST_TRIES} designs",
        hint="`volcal plan` tells what is in the way",
    )


def _within(setting: DesignProblem, search: ExchangeSearch, goal: Goal) -> tuple[int, ...]:
    """The search sums the minutes of its positions; a slot must hold for the plan as a whole, so it is drawn in."""
    asked = goal
    while True:
        with translated(InputError):
            chosen = goal.select(search)
        if not isinstance(goal, TimeSlotGoal) or not isinstance(asked, TimeSlotGoal):
            return chosen
        positions = setting.in_order([search.candidates.positions[index] for index in chosen])
        over = setting.minutes(positions) - asked.minutes
        if over <= 0.0:
            return chosen
        goal = TimeSlotGoal(goal.minutes - _MARGIN * over - _LITTLE_MIN)


def _held_out(setting: DesignProblem, candidates: CandidatePositions, chosen: Sequence[int]) -> tuple[Position, ...]:
    """As many orientations as the settings hold out, each at every station of the verification."""
    job = setting.job
    groups: dict[tuple[float, float], list[int]] = {}
    for index, position in enumerate(candidates.positions):
        if position.station in job.verified_stations and position.tool is None and setting.passes(position):
            groups.setdefault((position.azimuth_deg, position.elevation_deg), []).append(index)
    whole = [group for group in groups.values() if len(group) == len(job.verified_stations)]
    count = len(job.settings.verification.positions_deg)
    with translated(InputError, key="--verify-set"):
        telling = most_informative_groups(candidates, chosen, whole, count)
    return tuple(candidates.positions[index] for group in telling for index in group)


def _refused(setting: DesignProblem, positions: Sequence[Position], held_out: Sequence[Position]) -> Position | None:
    """The position at which the real preflight stops; PlanRefused where it stops at another place."""
    for job, own in setting.by_tool(positions):
        proof = tuple(held_out) or job.held_out
        try:
            run_preflight(replace(job, positions=own, held_out=proof))
        except PlanRefused as error:
            step = error.where.get("step", "")
            for position in positions:
                if f"/{position_key(position)}/" in step:
                    return position
            raise
    return None
