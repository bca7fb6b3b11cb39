"""Plan of a nightly run. It is made, and checked by a preflight, before the machine moves.

The positions can be chosen before the night, because the choice depends only on the covariance of the prior, the
estimate of the last accepted night.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from math import nan

from agent.errors import PlanRefused
from agent.execution.steps import Point
from agent.planning.cycle_time import expected_plan, plan_minutes
from agent.planning.job import Job, KnownHeldOut, Planner
from agent.planning.preflight import PreflightResult, run_preflight
from agent.probing.run_plan import MeasuringOrder
from agent.runs.kinds.drift_check import Judge
from agent.runs.kinds.position_choice import PositionChooser
from drivers.errors import ConfigurationError
from twin.arrays import Array
from twin.artefact.position_set import Position
from twin.identification import CarriedOverPrior

VERIFICATION, FURTHER = "look", "further"
MIN_FUSED_POSITIONS = 2
"""Smallest number of positions that are fused; fewer cannot separate machine errors from artefact errors."""

_AHEAD = 1.3  # time to choose for, relative to the time left: positions together cost less than one by one
_ROUNDING_MIN = 1e-6  # the minutes of the ideal machine are those of the preflight but for rounding
_MOST_TRIES = 6
_MOST = 100


@dataclass(frozen=True, eq=False)
class NightPlan:
    """Positions of a nightly run at `station`, in the order in which they are measured.

    The verification of the machine measures `held_out` and then `check_positions`. The positions `further` follow. At
    the end, `held_out` is measured again for the proof of the new table. These held-out positions are not used for the
    estimate.
    """

    station: int
    held_out: tuple[Position, ...]
    check_positions: tuple[Position, ...]
    further: tuple[Position, ...] = ()

    @property
    def first(self) -> tuple[Position, ...]:
        return (*self.held_out, *self.check_positions)

    def job(self, job: Job) -> Job:
        """Return `job` with the positions of this night: the positions that enter the estimate, and the held-out
        positions, which do not."""
        return replace(
            job_at_station(job, self.station),
            positions=(*self.check_positions, *self.further),
            held_out_choice=KnownHeldOut(self.held_out),
            allowed_stations=(self.station,),
        )

    def order(self, prefix: str, positions: Sequence[Position]) -> MeasuringOrder:
        return MeasuringOrder(prefix, tuple(positions), self.station)


def job_at_station(job: Job, station: int) -> Job:
    """Return `job` with the artefact at `station` and without the reversal check (measurement of lost motion), which
    would take too long in a slot."""
    stations = job.settings.stations.model_copy(update={"standing_at": station})
    preparation = replace(job.preparation, reversal=None)
    return replace(job, settings=job.settings.model_copy(update={"stations": stations}), preparation=preparation)


def station_of(job: Job, named: int | None) -> int:
    """Return the station of the artefact for a nightly run or a verification. It is `named`, or the station named in
    the settings if `named` is None.

    Raises ConfigurationError if neither is given, if the machine has no such station, or if the artefact is placed by
    hand, because such a run is unattended.
    """
    if job.settings.stations.placed_by_hand:
        raise ConfigurationError(
            "the artefact is placed by hand, and an unattended run has nobody to place it",
            key="stations.placed_by_hand",
            hint="run `volcal calibrate` with an operator at the machine, or use a mount for unattended runs",
        )
    station = named if named is not None else job.settings.stations.standing_at
    if station is None:
        raise ConfigurationError(
            "the artefact's station is not set, and at night it stays where it stands",
            key="stations.standing_at",
            hint="set it or pass --standing-at",
        )
    if station not in job.layout.locations_mm:
        raise ConfigurationError(f"there is no station {station}", key="stations.places_mm")
    return station


def night_check(chooser: PositionChooser, prior: CarriedOverPrior, change: Array) -> NightPlan:
    """Return the positions at the beginning of a night, which show if the machine is still as in the last accepted
    night.

    `prior` is the estimate of that night with the drift since then, and `change` (p, p) contains the expected squares
    and products of the change of the p model parameters since the active table was computed.
    """
    chosen = chooser.job.settings.nightly
    held_out = _held_out(chooser, prior, change, chosen.held_out_positions)
    return NightPlan(chooser.station, held_out, chooser.detecting_jumps(prior, chosen.check_positions, held_out))


def night_plan(
    chooser: PositionChooser,
    judge: Judge,
    slot_minutes: float,
    start_mm: Point,
    watch: Callable[[], None],
    planner: Callable[[NightPlan], Planner],
) -> tuple[NightPlan, PreflightResult]:
    """Plan as many positions as fit into the slot minus its reserve. Return the plan and its preflight, from which the
    duration is taken. `planner` returns the function that makes the plan of a night with the given positions. Only the
    chosen one is walked in every branch.

    Raises PlanRefused if the slot is too short.
    """
    chosen = chooser.job.settings.nightly
    check = night_check(chooser, judge.prior, judge.expected_change)
    held_out, checked = check.held_out, check.check_positions
    room = slot_minutes - chosen.reserve_minutes
    budget = max(room - 2.0 * chooser.minutes(held_out), 0.0)
    ahead = _AHEAD * max(budget - chooser.minutes(checked), 0.0)
    best = chooser.by_gain(judge.prior, most=_MOST, minutes=ahead, measured=checked, left_out=(*held_out, *checked))
    offered = (*checked, *best)
    count, tried = _fitting(chooser, offered, budget), dict[int, tuple[NightPlan, float]]()
    for _ in range(_MOST_TRIES):
        count = max(count, MIN_FUSED_POSITIONS, len(checked))
        if count in tried or count > len(offered):
            break
        watch()
        plan = NightPlan(
            chooser.station, held_out, offered[: chosen.check_positions], offered[chosen.check_positions : count]
        )
        own = plan.job(chooser.job)
        # the ideal machine looks for no collisions, which takes most of the time of a preflight
        tried[count] = plan, plan_minutes(own, expected_plan(planner(plan)(own)), start_mm)
        left = room - tried[count][1] - _ROUNDING_MIN
        more = offered[count : count + 1]
        count += 1 if more and left > chooser.minutes(more) else -1 if left < 0.0 else 0
    # the preflight has the last word
    for number in sorted(tried, reverse=True):
        plan, minutes = tried[number]
        if minutes > room:
            continue
        preflight = run_preflight(plan.job(chooser.job), planner(plan), start_mm, watch)
        if preflight.machine_minutes <= room:
            return plan, preflight
        tried[number] = plan, preflight.machine_minutes
    raise _too_short(slot_minutes, chosen.reserve_minutes, min((minutes for _, minutes in tried.values()), default=nan))


def _held_out(chooser: PositionChooser, prior: CarriedOverPrior, change: Array, count: int) -> tuple[Position, ...]:
    held_out = chooser.held_out(prior, change, count)
    if not held_out:
        raise ConfigurationError(
            f"none of the held-out orientations can be measured at station {chooser.station}",
            key="verification.positions_deg",
            hint="choose orientations with three balls within reach there",
        )
    return held_out


def _fitting(chooser: PositionChooser, offered: Sequence[Position], budget: float) -> int:
    count = 0
    while count < len(offered) and chooser.minutes(offered[: count + 1]) <= budget:
        count += 1
    return count


def _too_short(slot: float, reserve: float, shortest: float) -> PlanRefused:
    return PlanRefused(
        f"a slot of {slot:g} min is too short: the shortest night takes {shortest:.1f} min and {reserve:g} min reserve",
        hint="give a longer slot, fewer touches, or run `volcal verify`",
    )
