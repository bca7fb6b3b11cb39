"""Preparation of a job from the settings and from the files that the settings name. No device is contacted."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from agent.files import translated
from agent.model_files import load_machine, load_positions
from agent.planning.ball_consistency import ball_consistency
from agent.planning.held_out_positions import (
    LazyHeldOut,
    held_out_grid,
    listed_positions,
    verification_stations,
)
from agent.planning.job import HeldOutChoice, Job, KnownHeldOut
from agent.planning.procedure_rules import layout_of, preparation_of, probing_of, retreat_of
from agent.planning.stations import Artefacts, check_stations, hand_placement, load_artefacts, station_change
from agent.probing.position import PositionRules
from agent.probing.run_plan import gap_above_mm
from agent.settings.load import POSITION_FILES
from agent.settings.schema import Settings
from agent.thermal.rules import drift_limits_of, settling_of
from drivers.errors import ConfigurationError
from twin.arrays import Array
from twin.artefact.artefact import Artefact
from twin.artefact.position_set import MIN_BALLS, Position, parse_position_set
from twin.collision.geometry import point
from twin.collision.locating_balls import depth_in_table_mm, locating_balls
from twin.collision.measuring_layout import MeasuringLayout
from twin.collision.probe_frame import ProbeFrame
from twin.design.candidates import orientation_grid
from twin.errors import TwinError
from twin.machine.kinematic_chain import AXES
from twin.machine.machine_description import MachineDescription
from twin.units import S_PER_MIN

IN_TABLE_MM = 1.0
"""Depth in mm to which an artefact that is placed by hand may be inside the table according to its file."""


def prepare_job(settings: Settings, base: Path, artefact: Artefact | None = None) -> Job:
    """Load the files that the settings name, check that they are consistent, and return the job.

    `base` is the folder to which the path of a position file is relative. If `artefact` is given, it replaces that of
    the settings. Held-out positions that the settings do not list are chosen when `Job.held_out` is first read. Raises
    ConfigurationError if a file cannot be used or if the files and settings are not consistent.
    """
    machine, artefacts, frame = _loaded(settings)
    artefacts = artefacts if artefact is None else Artefacts(artefact)
    stations = tuple(settings.procedure.stations or range(1, len(settings.stations.places_mm) + 1))
    positions = _positions(
        settings.procedure.position_set, stations, len(settings.stations.places_mm), base, settings.tool, frame
    )
    allowed = (*stations, *(p.station for p in positions), *verification_stations(settings))
    probing = probing_of(settings.procedure, settings.probe.tip_radius_mm, artefacts.kind, frame)
    layout = layout_of(settings, machine, artefacts, probing)
    job = Job(
        settings=settings,
        machine=machine,
        artefact=artefacts.all,
        positions=positions,
        held_out_choice=KnownHeldOut(),
        allowed_stations=tuple(dict.fromkeys(allowed)),
        layout=layout,
        preparation=preparation_of(settings, machine, artefacts, probing),
        rules=PositionRules(
            probing,
            retreat_of(layout, settings.stations, settings.procedure, settings.timing, machine),
            drift_limits_of(settings.procedure, settings.temperature),
            settling_of(settings.temperature),
            station_change(settings.roles, settings.stations),
            hand_placement(settings),
            ball_consistency(settings, machine, layout, probing),
            settings.procedure.repeat_first_ball,
        ),
        gate_limits=settings.gates,
    )
    _refuse_unknown_radius(job)
    _refuse_grid_of_nights(settings)
    _refuse_low_mount(job)
    _refuse_unsafe_placement(job)
    _refuse_nothing_reachable(job)
    if settings.procedure.position_set.endswith(POSITION_FILES):
        _refuse_unreachable_entry(job)
    return replace(job, held_out_choice=_held_out_choice(job))


def with_places(job: Job, places_mm: Mapping[int, Array]) -> Job:
    """Return `job` with its stations at other places along their axis. `places_mm` maps the number of each station to
    its place (3,) in mm. The positions of the job are not checked again."""
    stations = job.settings.stations.model_copy(
        update={"places_mm": [point(places_mm[number]) for number in sorted(places_mm)]}
    )
    settings = job.settings.model_copy(update={"stations": stations})
    layout = job.layout.with_locations(places_mm)
    retreat = retreat_of(layout, stations, settings.procedure, settings.timing, job.machine)
    moved = replace(
        job,
        settings=settings,
        layout=layout,
        preparation=replace(job.preparation, layout=job.preparation.layout.with_locations(places_mm)),
        rules=replace(
            job.rules,
            retreat=retreat,
            consistency=ball_consistency(settings, job.machine, layout, job.rules.probing),
        ),
    )
    return replace(moved, held_out_choice=_held_out_choice(moved))


def prepare_layout(settings: Settings) -> MeasuringLayout:
    """Load machine and artefact, and return where the artefact stands and what is within reach, as in `prepare_job`;
    positions are not read. Raises ConfigurationError if a file cannot be used."""
    machine, artefacts, frame = _loaded(settings)
    probing = probing_of(settings.procedure, settings.probe.tip_radius_mm, artefacts.kind, frame)
    return layout_of(settings, machine, artefacts, probing)


def _loaded(settings: Settings) -> tuple[MachineDescription, Artefacts, ProbeFrame]:
    check_stations(settings)
    machine = load_machine(settings.machine)
    artefacts = load_artefacts(settings.artefact, settings.stations)
    if settings.tool not in machine.tools:
        raise ConfigurationError(
            f"the machine has no tool {settings.tool!r}",
            key="tool",
            hint=f"tools of {settings.machine.name}: {', '.join(sorted(machine.tools))}",
        )
    with translated(ConfigurationError, file=str(settings.machine), key=f"tools.{settings.tool}.offset_mm"):
        frame = ProbeFrame.of(machine.tools[settings.tool])
    return machine, artefacts, frame


def _refuse_unknown_radius(job: Job) -> None:
    probing, qualifying = job.rules.probing, job.preparation.qualification
    if not probing.determines_radius and qualifying is None:
        raise ConfigurationError(
            f"{len(probing.directions)} touches do not determine the radius of a ball, and the stylus is not qualified",
            key="procedure.touches_per_ball",
            hint="set qualification.enabled = true, or touch each ball five times",
        )


def _refuse_grid_of_nights(settings: Settings) -> None:
    """The positions of nights and verifications are chosen on this grid, long after the settings were accepted."""
    with translated(ConfigurationError, key="nightly.grid_deg"):
        orientation_grid(settings.nightly.grid_deg)


def _held_out_choice(job: Job) -> HeldOutChoice:
    """Return the held-out positions that the settings list; if there are none, a choice made on first access."""
    if job.settings.verification.positions_deg is None:
        held_out_grid(job.settings)
        return LazyHeldOut(job)
    listed = listed_positions(job.settings, verification_stations(job.settings))
    _refuse_overlap(job.positions, listed)
    return KnownHeldOut(listed)


def _positions(
    name: str, stations: Sequence[int], station_count: int, base: Path, tool: str, frame: ProbeFrame
) -> tuple[Position, ...]:
    """Return the positions of the named sets at `stations`, or all positions of a position file."""
    if name.endswith(POSITION_FILES):
        listed = load_positions(base / name)
        unknown = sorted({p.station for p in listed} - set(range(1, station_count + 1)))
        if unknown:
            raise ConfigurationError(
                f"the position file names station {unknown[0]}, which has no place",
                file=name,
                key="stations.places_mm",
            )
        return tuple(_with_tool_of_run(p, number, name, tool) for number, p in enumerate(listed, start=1))
    with translated(ConfigurationError, key="procedure.position_set"):
        everywhere = parse_position_set(name, station_count, frame.facing_deg)
    return tuple(p for p in everywhere if p.station in stations)


def _with_tool_of_run(position: Position, number: int, file: str, tool: str) -> Position:
    if position.tool not in (None, tool):
        raise ConfigurationError(
            f"position {number} is to be measured with tool '{position.tool}', the run has '{tool}'",
            file=file,
            key="tool",
            hint="a run has one tool: make one file for each, and fuse the runs' estimates",
        )
    return replace(position, tool=None)


def _refuse_overlap(positions: Sequence[Position], held_out: Sequence[Position]) -> None:
    common = set(positions) & set(held_out)
    if common:
        first = min(common, key=lambda p: p.station)
        raise ConfigurationError(
            f"position az {first.azimuth_deg:g}° el {first.elevation_deg:g}° is measured for the estimate, "
            "so it cannot prove it",
            key="verification.positions_deg",
            hint="choose orientations that the position set does not contain",
        )


def _refuse_low_mount(job: Job) -> None:
    """Raise ConfigurationError if the artefact at a station is not even free at the elevation 0."""
    for station in job.layout.locations_mm:
        elevations = job.layout.elevations(station)
        if not elevations.contains(0.0):
            raise ConfigurationError(
                f"the artefact at station {station} hits the {elevations.obstacle} at the elevation 0",
                key="stations.places_mm",
                hint="raise the mount, or correct mount.table_z_mm and the parts in the artefact file",
            )


def _refuse_unsafe_placement(job: Job) -> None:
    """Raise ConfigurationError if an artefact that is placed by hand would stand in the table, or if it could not be
    located safely in a position that is to be measured."""
    if job.layout.placement is None:
        return
    _refuse_fast_search(job)
    listed = listed_positions(job.settings, verification_stations(job.settings))
    for position in (*job.positions, *listed):
        where = f"station {position.station}, azimuth {position.azimuth_deg:g}°, elevation {position.elevation_deg:g}°"
        sunk_mm = depth_in_table_mm(job.layout, position)
        if sunk_mm > IN_TABLE_MM:
            raise ConfigurationError(
                f"the artefact would be {sunk_mm:.1f} mm inside the table at {where}",
                key="stations.places_mm",
                hint="correct the height of the place, mount.table_z_mm, or the parts in the artefact file",
            )
        balls = np.flatnonzero(job.layout.reachable(position, job.layout.nominal(position))).tolist()
        if len(balls) >= MIN_BALLS:
            _refuse_no_gap(job, position, where)
            try:
                locating_balls(job.layout, position, balls)
            except TwinError as error:
                raise ConfigurationError(
                    f"{error.message} ({where})", key="procedure.position_set", hint=error.hint
                ) from error


def _refuse_fast_search(job: Job) -> None:
    """Raise ConfigurationError if the tip, which searches an artefact along the stylus, would reach the holder of a
    ball on which it comes down before the axis stands."""
    feed_mm_per_s = job.settings.procedure.guarded_feed_mm_per_min / S_PER_MIN
    acceleration = job.machine.acceleration_mm_per_s2[job.layout.frame.axis]
    braking_mm = feed_mm_per_s**2 / (2.0 * acceleration)
    free_mm = job.artefact.ball_radius_mm - job.artefact.body.holder_radius_mm
    if free_mm <= 0.0:
        raise ConfigurationError(
            "the balls are not thicker than their holders, so the tip could meet a holder while it looks for a ball",
            key="artefact",
            hint="use an artefact with thicker balls or thinner holders",
        )
    if braking_mm >= free_mm:
        axis = AXES[job.layout.frame.axis]
        raise ConfigurationError(
            f"the search for the artefact is too fast: after the contact with a ball, the tip moves {braking_mm:.1f} mm"
            f" until {axis} stands, and reaches the holder of the ball after {free_mm:.1f} mm",
            key="procedure.guarded_feed_mm_per_min",
            hint=f"state less than {math.floor(math.sqrt(2.0 * acceleration * free_mm) * S_PER_MIN)} mm/min",
        )


def _refuse_no_gap(job: Job, position: Position, where: str) -> None:
    """Raise ConfigurationError if the probe could not cross above an artefact that stands within its tolerance."""
    assert job.layout.placement is not None  # noqa: S101  the artefact is placed by hand
    tolerance_mm = job.layout.placement.distance_mm
    gap_mm = gap_above_mm(position, job.layout, job.rules)
    if gap_mm <= tolerance_mm:
        raise ConfigurationError(
            f"the probe cannot cross above the artefact ({where}): at the end of travel, the tip is {gap_mm:.1f} mm "
            f"above it, and the artefact may stand {tolerance_mm:g} mm too high",
            key="stations.places_mm",
            hint="lower the place of the station, or use a shorter tool",
        )


def _refuse_nothing_reachable(job: Job) -> None:
    if all(reached_balls(job, position) < MIN_BALLS for position in job.positions):
        raise ConfigurationError(
            "no position has three balls within the travel",
            key="stations.places_mm",
            hint="check the stations' places, the mount's shaft and the tool offset",
        )


def _refuse_unreachable_entry(job: Job) -> None:
    """Raise ConfigurationError if an entry of a position file is out of reach.

    Unreachable positions of a named set are left out and counted, but every entry of a position file must be
    measurable.
    """
    for number, position in enumerate(job.positions, start=1):
        reached = reached_balls(job, position)
        if reached < MIN_BALLS:
            raise ConfigurationError(
                f"position {number} (station {position.station}, azimuth {position.azimuth_deg:g}°, elevation "
                f"{position.elevation_deg:g}°) has {reached} balls within reach, three are needed",
                file=job.settings.procedure.position_set,
                hint="leave it out, or choose another orientation or station",
            )


def reached_balls(job: Job, position: Position) -> int:
    """Return the number of balls that the probe can measure in `position`: within the travel and accessible."""
    return int(job.layout.reachable(position, job.layout.nominal(position)).sum())
