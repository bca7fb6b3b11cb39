"""Problem of choosing a position set for a job: the candidate positions, the machine time of each, and the check
whether each can be measured.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from agent.planning.cycle_time import machine_minutes
from agent.planning.design.feasibility import FeasibilityCheck
from agent.planning.job import Job
from agent.planning.planning_options import planning_options
from twin.artefact.position_set import Position
from twin.design.candidates import CandidatePositions, build_candidates, orientation_grid
from twin.design.measuring_cost import MeasuringCosts
from twin.design.procedure import Procedure
from twin.design.search import ExchangeSearch
from twin.identification import Options
from twin.machine.volumetric import evaluation_grid

_TOOL_STRIDE = 10_000  # each tool is a run of its own, so its stations cost carries of their own


@dataclass(frozen=True, eq=False)
class DesignProblem:
    """Problem of choosing a position set: the candidate positions, the machine time of each, and the check whether each
    can be measured.

    `jobs` maps the name of each tool to the job with that tool; the tool of the settings is the first. `grid_deg` is
    the spacing of the candidate orientations of the artefact in degrees. `refused` contains the positions that a
    preflight has refused. `feasibility` maps the name of a tool to the feasibility check with that tool; the checks
    remain valid if further positions are refused.
    """

    jobs: Mapping[str, Job]
    grid_deg: float
    refused: frozenset[Position] = frozenset()
    feasibility: dict[str, FeasibilityCheck] = field(default_factory=dict, repr=False)

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
        return planning_options(self.job.settings.temperature)

    @property
    def procedure(self) -> Procedure:
        layouts = {name: job.layout for name, job in self.jobs.items()}
        return replace(self.job.procedure, layouts=layouts)

    def refusing(self, position: Position) -> DesignProblem:
        return replace(self, refused=self.refused | {position})

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
        tools = list(self.jobs)
        minutes = np.array([self.feasibility_of(position).minutes(position) for position in candidates.positions])
        codes = [_TOOL_STRIDE * (tools.index(p.tool) if p.tool else 0) + p.station for p in candidates.positions]
        return MeasuringCosts(
            minutes=minutes,
            stations=np.array(codes),
            carry_minutes=self.job.settings.timing.relocation_minutes,
            standing_at=self.job.settings.stations.standing_at,
        )

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

    def minutes(self, chosen: Sequence[Position]) -> float:
        """Return the machine minutes of all positions `chosen`, measured in the given order.

        The time is computed by executing the plan of the run on an ideal machine.
        """
        return sum(machine_minutes(job, own).total for job, own in self.by_tool(chosen))

    def _offered(self) -> Iterator[Position]:
        job = self.job
        stations = job.settings.procedure.stations or sorted(job.layout.locations_mm)
        listed = job.settings.verification.positions_deg is not None  # otherwise they are chosen to suit the design
        held_out = set(job.held_out) if listed else set()
        for name in self.jobs:
            tool = None if name == job.settings.tool else name
            for station in stations:
                for azimuth, elevation in orientation_grid(self.grid_deg):
                    if Position(station, azimuth, elevation) not in held_out:
                        yield Position(station, azimuth, elevation, tool)


def _nearest_first(positions: list[Position]) -> list[Position]:
    left, ordered, azimuth, elevation = list(positions), [], 0.0, 0.0
    while left:
        nearest = min(left, key=lambda p: max(abs(p.azimuth_deg - azimuth), abs(p.elevation_deg - elevation)))
        left.remove(nearest)
        ordered.append(nearest)
        azimuth, elevation = nearest.azimuth_deg, nearest.elevation_deg
    return ordered
