"""Problem of choosing a position set for a job: the candidate positions, the machine time of each, and the check
whether each can be measured.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from agent.planning.design.feasibility import FeasibilityCheck
from agent.planning.held_out_positions import LazyHeldOut
from agent.planning.job import HeldOutChoice, Job, KnownHeldOut, Planner
from agent.planning.job_preparation import with_places
from agent.planning.planning_options import planning_options
from agent.planning.run_minutes import PHASES, PREPARATION, RunMinutes, held_out_keys, phase_of, run_minutes, run_steps
from twin.arrays import Array
from twin.artefact.position_set import CHECKABLE_BALLS, Position
from twin.design.candidates import CandidatePositions, build_candidates, orientation_grid, spread_balls
from twin.design.measuring_cost import MeasuringCosts
from twin.design.procedure import Procedure
from twin.design.search import ExchangeSearch
from twin.identification import Options
from twin.identification.instruments.readings import InstrumentReadings
from twin.machine.volumetric import evaluation_grid
from twin.units import S_PER_MIN

_TOOL_STRIDE = 10_000  # each tool is a run of its own, so its stations cost carries of their own


@dataclass(frozen=True, eq=False)
class DesignProblem:
    """Problem of choosing a position set: the candidate positions, the machine time of each, and the check whether each
    can be measured.

    `jobs` maps the name of each tool to the job with that tool; the tool of the settings is the first. `grid_deg` is
    the spacing of the candidate orientations of the artefact in degrees. `plan_of` returns the plan of the run for
    which the positions are chosen; all minutes are those of this plan. Of the balls of each position within reach, the
    share `ball_share` is measured. `refused` contains the positions that a preflight has refused. `feasibility` maps
    the name of a tool to the feasibility check with that tool; the checks remain valid if further positions are
    refused. `instruments` are planned readings of other instruments; where they are taken matters, not what they show.
    """

    jobs: Mapping[str, Job]
    grid_deg: float
    plan_of: Planner
    ball_share: float = 1.0
    refused: frozenset[Position] = frozenset()
    feasibility: dict[str, FeasibilityCheck] = field(default_factory=dict, repr=False)
    instruments: tuple[InstrumentReadings, ...] = ()

    @property
    def job(self) -> Job:
        return next(iter(self.jobs.values()))

    @property
    def options(self) -> Options:
        """Options of the identification whose expected volumetric error after compensation (VCE) is minimised by the
        design.

        This identification of the machine's errors uses ball centres, and takes all uncertainties as stated in the
        machine and artefact files and in the settings.
        """
        return replace(planning_options(self.job.settings.temperature), instruments=self.instruments)

    @property
    def procedure(self) -> Procedure:
        layouts = {name: job.layout for name, job in self.jobs.items()}
        return replace(self.job.procedure, layouts=layouts)

    def refusing(self, position: Position) -> DesignProblem:
        return replace(self, refused=self.refused | {position})

    def with_places(self, places_mm: Mapping[int, Array]) -> DesignProblem:
        """Return the problem with the stations at other places (3,) in mm along their axis. Positions that a preflight
        has refused are offered again."""
        jobs = {name: with_places(job, places_mm) for name, job in self.jobs.items()}
        return DesignProblem(jobs, self.grid_deg, self.plan_of, self.ball_share, instruments=self.instruments)

    def feasibility_of(self, position: Position) -> FeasibilityCheck:
        """Return the check whether positions can be measured with the tool of `position`."""
        name = position.tool or next(iter(self.jobs))
        if name not in self.feasibility:
            self.feasibility[name] = FeasibilityCheck(self.jobs[name])
        return self.feasibility[name]

    @cached_property
    def candidates(self) -> CandidatePositions:
        """Candidate positions, and the information about the machine's error field that a measurement of each position
        would give.

        Raises TwinError if no candidate position is within reach of the axes.
        """
        job = self.job
        grid = evaluation_grid(job.machine.model.ranges_mm)
        offered = [position for position in self._offered() if position not in self.refused]
        return build_candidates(self.procedure, offered, job.machine.family, self.options, grid, job.tool_offset_mm)

    @cached_property
    def search(self) -> ExchangeSearch:
        candidates = self.candidates
        return ExchangeSearch(
            candidates, self.prices(candidates), lambda index: self.passes(candidates.positions[index])
        )

    def passes(self, position: Position) -> bool:
        """Return True if `position` can be measured without a collision."""
        return not self.feasibility_of(position).hit(position)

    def prices(self, candidates: CandidatePositions) -> MeasuringCosts:
        """Return the approximate machine minutes of each candidate, and those of the run apart from them."""
        tools, first = list(self.jobs), self.job
        minutes = np.empty(candidates.count)
        of_tool = np.array([tools.index(p.tool) if p.tool else 0 for p in candidates.positions])
        for tool in np.unique(of_tool):
            own = np.flatnonzero(of_tool == tool)
            positions = [candidates.positions[index] for index in own]
            minutes[own] = self.feasibility_of(positions[0]).estimated_minutes(positions, candidates.balls[own])
        codes = _TOOL_STRIDE * of_tool + [position.station for position in candidates.positions]
        carried = first.rules.placement is None and first.rules.change.moves_artefact
        costs = MeasuringCosts(
            minutes=minutes,
            stations=codes,
            carry_minutes=first.settings.timing.relocation_minutes if carried else 0.0,
            standing_at=first.settings.stations.standing_at,
        )
        return self._with_rest_of_run(costs, candidates)

    def _with_rest_of_run(self, costs: MeasuringCosts, candidates: CandidatePositions) -> MeasuringCosts:
        """Return `costs` with the minutes that the run takes apart from the position set: its checks, its held-out
        positions, and the changes to the stations of both. They are those of a run that measures two candidates."""
        own = [number for number, position in enumerate(candidates.positions) if position.tool is None]
        pair = sorted(own, key=lambda number: costs.minutes[number])[:2]
        if not pair:
            return costs
        ((job, positions),) = self.by_tool([candidates.positions[number] for number in pair])
        keys = held_out_keys(positions)
        fixed_s, carries, visited = 0.0, 0, set[int]()
        for timed in run_steps(
            replace(job, positions=positions, held_out_choice=held_out_of(job, positions)), self.plan_of
        ):
            _, *rest = timed.step.key.split("/")
            if timed.carrying and rest[0].startswith("carry-"):
                carries += 1
            elif phase_of(timed.step, frozenset()) == PREPARATION or "/".join(rest[:2]) not in keys:
                fixed_s += timed.seconds
                visited.add(int(rest[0].removeprefix("station-")))
        charged = replace(costs, visited_anyway=frozenset(visited))
        paid = carries * costs.carry_minutes - (charged.total(pair) - float(costs.minutes[pair].sum()))
        return replace(charged, fixed_minutes=max(0.0, fixed_s / S_PER_MIN + paid))

    def in_order(self, chosen: Sequence[Position]) -> tuple[Position, ...]:
        """Return the positions `chosen` sorted by tool, then by station.

        The positions at one station are ordered so that the mount turns little from one to the next.
        """
        ordered: list[Position] = []
        for name in self.jobs:
            tool = None if name == self.job.settings.tool else name
            of_tool = [position for position in chosen if position.tool == tool]
            for station in sorted({position.station for position in of_tool}):
                ordered += _nearest_first([position for position in of_tool if position.station == station])
        return tuple(ordered)

    def by_tool(self, chosen: Sequence[Position]) -> Iterator[tuple[Job, tuple[Position, ...]]]:
        """Yield, for each tool in use, a pair of the job with this tool and the positions of `chosen` that are measured
        with it.

        The yielded positions name no tool, because the job does.
        """
        for name, job in self.jobs.items():
            tool = None if name == self.job.settings.tool else name
            own = tuple(replace(position, tool=None) for position in chosen if position.tool == tool)
            if own:
                yield job, own

    def runs(self, chosen: Sequence[Position], held_out: Sequence[Position] = ()) -> Iterator[Job]:
        """Yield the jobs of the runs that measure the positions `chosen`, one for each tool in use.

        If `held_out` is empty, the held-out positions are those that the run would have with these settings.
        """
        for job, own in self.by_tool(chosen):
            yield replace(job, positions=own, held_out_choice=held_out_of(job, own, held_out))

    def minutes(self, chosen: Sequence[Position], held_out: Sequence[Position] = ()) -> float:
        """Return the machine minutes of the runs that measure the positions `chosen`; the arguments are as for
        `runs`."""
        steps = (timed for job in self.runs(chosen, held_out) for timed in run_steps(job, self.plan_of))
        return sum(timed.seconds for timed in steps) / S_PER_MIN

    def minutes_by_phase(self, chosen: Sequence[Position], held_out: Sequence[Position] = ()) -> RunMinutes:
        """Return the machine minutes of `minutes` by phase."""
        each = [run_minutes(job, self.plan_of) for job in self.runs(chosen, held_out)]
        return RunMinutes({phase: sum(one.by_phase[phase] for one in each) for phase in PHASES})

    def _offered(self) -> Iterator[Position]:
        job = self.job
        stations = job.settings.procedure.stations or sorted(job.layout.locations_mm)
        listed = job.settings.verification.positions_deg is not None  # otherwise they are chosen to suit the design
        held_out = set(job.held_out) if listed else set()
        for name in self.jobs:
            tool = None if name == job.settings.tool else name
            for station in stations:
                for azimuth, elevation in orientation_grid(self.grid_deg):
                    position = Position(station, azimuth, elevation, tool)
                    if replace(position, tool=None) not in held_out:
                        yield self._with_share(name, position)

    def _with_share(self, tool: str, position: Position) -> Position:
        """Return `position` with the share of its balls within reach that is to be measured, spread over the artefact.
        At least `CHECKABLE_BALLS` balls remain."""
        if self.ball_share == 1.0:
            return position
        layout = self.jobs[tool].layout
        within_reach = np.flatnonzero(layout.reachable(position, layout.nominal(position))).tolist()
        count = max(CHECKABLE_BALLS, round(self.ball_share * len(within_reach)))
        if count >= len(within_reach):
            return position
        centres = layout.artefact_at(position.station).balls
        return replace(position, balls=spread_balls(centres, within_reach, count))


def held_out_of(job: Job, positions: Sequence[Position], known: Sequence[Position] = ()) -> HeldOutChoice:
    """Return the held-out positions of the run of `job` that measures `positions`: those of `known`, sorted by station
    as a settings file lists them, or those that the run itself would choose."""
    if known:
        return KnownHeldOut(tuple(sorted(known, key=lambda position: position.station)))
    return LazyHeldOut(replace(job, positions=tuple(positions)))


def _nearest_first(positions: list[Position]) -> list[Position]:
    left, ordered, azimuth, elevation = list(positions), [], 0.0, 0.0
    while left:
        nearest = min(left, key=lambda p: max(abs(p.azimuth_deg - azimuth), abs(p.elevation_deg - elevation)))
        left.remove(nearest)
        ordered.append(nearest)
        azimuth, elevation = nearest.azimuth_deg, nearest.elevation_deg
    return ordered
