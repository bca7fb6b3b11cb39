"""Candidate positions of a sequential calibration, which chooses each position from what it has measured so far.

Everything that does not depend on measured values is computed before the run: which positions can be measured without a
collision, the information that each would give, and the machine time that each takes.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import islice

import numpy as np

from agent.execution.steps import Plan
from agent.files import translated
from agent.planning.cycle_time import plan_minutes, walk_plan
from agent.planning.design.feasibility import FeasibilityCheck
from agent.planning.job import Job
from agent.planning.measuring_order import AT_REST_DEG
from agent.planning.planning_options import planning_options
from agent.planning.preflight import Standing
from agent.planning.time_model import TimeModel, time_model
from agent.probing.run_plan import MeasuredPositions, MeasuringOrder, measure_positions, position_key
from drivers.errors import ConfigurationError
from twin.arrays import Array
from twin.artefact.position_set import CHECKABLE_BALLS, Position
from twin.design.candidates import build_candidates, orientation_grid
from twin.design.search import Mask, Selection
from twin.design.sequential import OrderModel, PositionsSeen, ranked_choices
from twin.identification import Options
from twin.identification.order import ORDERS
from twin.machine.volumetric import evaluation_grid
from twin.units import S_PER_MIN

CANDIDATES = 60
"""Number of candidate positions. Their gains are computed again after each measured position."""

GRID_DEG = 15.0
"""Step of the orientations, azimuth and elevation, from which the candidates are taken, in degrees."""

MIN_POSITIONS = 6
"""Smallest number of positions from which a sequential calibration may end because its target is reached."""

LEAST_CARRY_MIN = 1.0
"""Least time in min for which a person who carries the artefact counts in a choice, whatever the settings state."""

HELD_OUT_PREFIX = "held-out"
_ALONE = "alone-"


@dataclass(frozen=True, eq=False)
class SequentialCandidates:
    """Candidate positions of a sequential calibration of `job`. The held-out positions are never candidates."""

    job: Job
    count: int = CANDIDATES
    grid_deg: float = GRID_DEG

    @cached_property
    def positions(self) -> tuple[Position, ...]:
        """Candidate positions, sorted by station, azimuth and elevation. Each has been checked for collisions.

        They are the positions that a design for a run of any length would choose first, out of a grid of orientations
        and the position set of the settings. Positions of few balls take little time, but a wrong ball in them could
        not be told from the others; they are left out, unless the artefact has no more balls. Raises ConfigurationError
        if no position can be measured.
        """
        job, held_out = self.job, {position_key(position) for position in self.job.held_out}
        stations = job.settings.procedure.stations or sorted(job.layout.locations_mm)
        grid = (Position(station, *angles) for station in stations for angles in orientation_grid(self.grid_deg))
        offered = [one for one in (*grid, *job.positions) if position_key(one) not in held_out]
        with translated(ConfigurationError, key="stations.places_mm"):
            field, options = self._field, planning_options(job.settings.temperature)
            every = build_candidates(job.procedure, offered, job.machine.family, options, field, job.tool_offset_mm)
        search = self._feasibility.search_among(
            every,
            standing_at=job.settings.stations.standing_at,
            carry_minutes=self._carry_s() / S_PER_MIN,
            estimate_minutes=True,
        )
        redundant: Mask = every.balls >= min(CHECKABLE_BALLS, job.artefact.count)
        grown = search.grow(Selection.of(every), lambda _: redundant, per_minute=True)
        chosen = [selection.chosen[-1] for selection in islice(grown, self.count)]
        if not chosen:
            raise ConfigurationError(
                "no position can be measured without a collision",
                key="stations.places_mm",
                hint="move the stations, or choose an artefact or a probe that leaves more room",
            )
        return tuple(every.positions[index] for index in sorted(chosen))

    @cached_property
    def models(self) -> tuple[OrderModel, ...]:
        """Models of the orders between which the identification chooses, with the information of each candidate."""
        chosen, machine = self.job.settings.identification, self.job.machine
        if isinstance(chosen.order, int):
            families = {chosen.order: machine.with_order(chosen.order).family}
        elif chosen.order == "evidence" and chosen.prior:
            families = {order: machine.with_order(order).family for order in ORDERS}
        else:
            families = {max(machine.model.highest_order): machine.family}
        procedure, field = self.job.procedure, self._field
        return tuple(
            OrderModel.build(order, family, procedure, self.positions, self.options, field)
            for order, family in families.items()
        )

    @property
    def options(self) -> Options:
        """Options of the identification on which the choice is based: ball centres and the prior of the family."""
        return replace(planning_options(self.job.settings.temperature), estimate_scales=True)

    def nothing_seen(self) -> PositionsSeen:
        order = max(self.job.machine.model.highest_order)
        return PositionsSeen.none(self.models, self.job.artefact, self.options, order)

    def ranked(self, seen: PositionsSeen, standing: Standing | None, left_out: Sequence[Position]) -> list[Position]:
        """Return the candidates by falling gain per second from where the artefact stands, without those in `left_out`
        and those without a gain."""
        allowed: Mask = np.array([position not in left_out for position in self.positions])
        seconds = self.seconds(standing, LEAST_CARRY_MIN)
        return [self.positions[index] for index in ranked_choices(seen, seconds, allowed)]

    def seconds(self, standing: Standing | None, least_carry_min: float = 0.0) -> Array:
        """Return the time (N,) in s that each candidate takes if the artefact stands at `standing`: the turn of the
        mount, the measurement and a change of station, which takes at least `least_carry_min` if a person carries the
        artefact. If `standing` is None, its place is not known."""
        turned = AT_REST_DEG if standing is None else (standing.azimuth_deg, standing.elevation_deg)
        turns = np.array([self._times.turn_s(turned, _angles(position)) for position in self.positions])
        stations = np.array([position.station for position in self.positions])
        changes = stations != (0 if standing is None else standing.station)  # stations count from 1
        return np.asarray(self._seconds_at_rest + turns + self._carry_s(least_carry_min) * changes)

    def tail_minutes(self, station: int) -> float:
        """Return the machine minutes from the end of the measurement at `station` to the end of the run: the held-out
        positions before and after the new table is active."""
        if station not in self._tails:
            self._tails[station] = plan_minutes(self.job, held_out_and_proof(self.job, station))
        return self._tails[station]

    def planned(self, minutes: float, standing: Standing | None) -> tuple[Position, ...]:
        """Return the positions that would be measured within `minutes`, held-out positions and proof included, if the
        machine were as its family states. The run measures others as soon as its own measurements speak for them."""

        def fits(position: Position, ends_min: float) -> bool:
            return ends_min + self.tail_minutes(position.station) <= minutes

        return tuple(self.sequence(standing, fits))

    def sequence(
        self, standing: Standing | None, fits: Callable[[Position, float], bool] = lambda *_: True
    ) -> Iterator[Position]:
        """Yield the positions in the order in which they would be measured if the machine were as its family states.

        `fits` takes a position and the time in min at which its measurement would end, and returns False if it cannot
        be measured any more. The sequence ends when nothing fits or gains.
        """
        seen, chosen, ends_min = self.nothing_seen(), list[Position](), 0.0
        index_of = {position: index for index, position in enumerate(self.positions)}
        while True:
            minutes = ends_min + self.seconds(standing) / S_PER_MIN
            ranked = self.ranked(seen, standing, chosen)
            position = next((one for one in ranked if fits(one, float(minutes[index_of[one]]))), None)
            if position is None:
                return
            yield position
            index = index_of[position]
            ends_min = float(minutes[index])
            chosen.append(position)
            seen, standing = seen.planned(index), standing_in(position)

    @cached_property
    def _tails(self) -> dict[int, float]:
        return {}

    @cached_property
    def _feasibility(self) -> FeasibilityCheck:
        return FeasibilityCheck(self.job)

    @cached_property
    def _times(self) -> TimeModel:
        return time_model(self.job.machine, self.job.settings.timing)

    @cached_property
    def _field(self) -> Array:
        return evaluation_grid(self.job.machine.model.ranges_mm)

    @cached_property
    def _seconds_at_rest(self) -> Array:
        """Time (N,) in s of each candidate, without the turn of the mount from both angles zero."""
        return np.array(
            [
                S_PER_MIN * (self._feasibility.minutes(position) - self._feasibility.turn_minutes(position))
                for position in self.positions
            ]
        )

    def _carry_s(self, least_min: float = LEAST_CARRY_MIN) -> float:
        """Return the time in s of a change of station, which is at least `least_min` if a person carries the
        artefact."""
        if not self.job.rules.change.moves_artefact:
            return 0.0
        return S_PER_MIN * max(self.job.settings.timing.relocation_minutes, least_min)


def standing_in(position: Position) -> Standing:
    """Return the place of the artefact after `position` has been measured."""
    return Standing(position.station, position.azimuth_deg, position.elevation_deg)


def minutes_one_by_one(job: Job, positions: Sequence[Position]) -> Array:
    """Return the machine minutes (N,) from the start until each of the N `positions` has been measured, in this order
    and one by one, as a sequential calibration measures them."""
    _, steps = walk_plan(job, _one_by_one(job, positions))
    ends = np.zeros(len(positions))
    for timed in steps:
        ends[int(timed.step.key.split("/")[0].removeprefix(_ALONE))] += timed.seconds
    return np.asarray(np.cumsum(ends) / S_PER_MIN)


def _one_by_one(job: Job, positions: Sequence[Position]) -> Plan[None]:
    standing_at, poses = job.settings.stations.standing_at, None
    for number, position in enumerate(positions):
        order = MeasuringOrder(f"{_ALONE}{number}", (position,), standing_at, first_number=number)
        measured = yield from measure_positions(order, job.layout, job.rules, poses)
        standing_at, poses = measured.standing_at, measured.mount_poses


def held_out_order(job: Job, standing_at: int | None, first_number: int = 0) -> MeasuringOrder:
    """Return the order in which the held-out positions are measured before a new table is active, in a run that has
    measured `first_number` positions and whose artefact stands at `standing_at`."""
    return replace(job.verification_order(standing_at), prefix=HELD_OUT_PREFIX, first_number=first_number)


def held_out_and_proof(job: Job, standing_at: int | None) -> Plan[MeasuredPositions]:
    """Measure the held-out positions before and after a new table is active, as every sequential calibration does at
    its end, whatever it has measured. Return the measurements of the proof."""
    before = yield from measure_positions(held_out_order(job, standing_at), job.layout, job.rules)
    order = job.verification_order(before.standing_at)
    return (yield from measure_positions(order, job.layout, job.rules))


def _angles(position: Position) -> tuple[float, float]:
    return position.azimuth_deg, position.elevation_deg
