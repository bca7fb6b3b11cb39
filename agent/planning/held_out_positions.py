"""Held-out positions of a job. These positions are measured to verify a new compensation table, but they are not used
for the estimate of the machine's errors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

from agent.files import translated
from agent.planning.design.feasibility import FeasibilityCheck
from agent.planning.job import Job
from agent.planning.planning_options import planning_options
from agent.settings.schema import Settings
from drivers.errors import ConfigurationError
from twin.artefact.position_set import Position
from twin.design.candidates import build_candidates, orientation_grid
from twin.design.held_out import least_known_positions
from twin.machine.volumetric import evaluation_grid

_GRID = (5, 4, 4)  # the field is needed only to tell the unknowns of the machine from those of the artefact


def verification_stations(settings: Settings) -> tuple[int, ...]:
    """Return the stations at which positions may be held out: those listed for the verification, or else all measured
    stations."""
    chosen = settings.verification.stations or settings.procedure.stations
    return tuple(chosen or range(1, len(settings.stations.places_mm) + 1))


def listed_positions(settings: Settings, stations: Sequence[int]) -> tuple[Position, ...]:
    """Return the orientations that the settings list for the verification, at each of the `stations`."""
    listed = settings.verification.positions_deg or ()
    return tuple(Position(station, azimuth, elevation) for station in stations for azimuth, elevation in listed)


def held_out_grid(settings: Settings) -> tuple[tuple[float, float], ...]:
    """Return the orientations (azimuth, elevation) in degrees that may be held out. Raises ConfigurationError if 90° is
    not a multiple of `verification.grid_deg`, or if this is too small."""
    with translated(ConfigurationError, key="verification.grid_deg"):
        return orientation_grid(settings.verification.grid_deg)


def held_out_positions(job: Job, positions: Sequence[Position]) -> tuple[Position, ...]:
    """Return the positions that verify an estimate made from `positions`.

    If the settings list orientations, these are held out at every station. Otherwise the positions are chosen by
    `least_known`. The choice depends only on the settings and on the files that they name, so a resumed run has the
    same held-out positions.
    """
    chosen, stations = job.settings.verification, verification_stations(job.settings)
    if chosen.positions_deg is None:
        return least_known(job, positions, stations, chosen.positions)
    return listed_positions(job.settings, stations)


@dataclass(frozen=True, eq=False)
class LazyHeldOut:
    """Held-out positions of `job`, chosen by `held_out_positions` when they are first read."""

    job: Job

    @cached_property
    def positions(self) -> tuple[Position, ...]:
        return held_out_positions(self.job, self.job.positions)


def least_known(job: Job, positions: Sequence[Position], stations: Sequence[int], count: int) -> tuple[Position, ...]:
    """Return at most `count` positions at `stations` whose balls are expected to show the largest error after
    compensation, if the machine's errors are estimated from `positions`. The positions are sorted by station.

    The candidates are the orientations on the grid `verification.grid_deg` that are not in `positions`, reach three
    balls and can be measured without a collision. The expected error follows from the machine file alone (prior
    population, misfit) and from the rules of `job`; see `twin.design.held_out`. Raises ConfigurationError if no
    position is within reach.
    """
    machine, grid, options = job.machine, held_out_grid(job.settings), planning_options(job.settings.temperature)
    offered = [Position(station, azimuth, elevation) for station in stations for azimuth, elevation in grid]
    field = evaluation_grid(machine.model.ranges_mm, _GRID)
    with translated(ConfigurationError, key="stations.places_mm"):
        candidates = build_candidates(
            job.procedure, [*positions, *offered], machine.family, options, field, job.tool_offset_mm
        )
    measured = set(positions)
    at = [index for index, position in enumerate(candidates.positions) if position in measured]
    feasibility, elsewhere = FeasibilityCheck(job), set(offered)

    def is_measurable(index: int) -> bool:
        position = candidates.positions[index]
        return position in elsewhere and not feasibility.hit(position)

    selected = [candidates.positions[index] for index in least_known_positions(candidates, at, count, is_measurable)]
    return tuple(sorted(selected, key=lambda position: position.station))
