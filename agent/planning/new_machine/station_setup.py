"""Mount, stations and orientations of the artefact: stated by a person, or proposed from machine and artefact."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from agent.planning.new_machine.artefact_setup import TOUCHED_MM, ArtefactSetup
from agent.planning.new_machine.machine_setup import PROPOSED, STATED, MachineSetup, Triple
from agent.planning.new_machine.spindle import points_up
from twin.artefact.placement_tolerance import MOUNT_ALLOWANCE_MM
from twin.artefact.position_set import Position
from twin.collision.probe_frame import VERTICAL, ProbeFrame
from twin.errors import DataError
from twin.machine.kinematic_chain import AXES

MOST_STATIONS = 6
OVERLAP = 1.5
"""Number of artefacts per travel along which the stations stand: neighbouring stations overlap by a half."""
END_SHARE = 0.93
"""Distance of the outer stations from the ends of the travel, relative to half the artefact."""
SHAFT_TOWARDS_SPINDLE = 0.85
"""Component of the shaft along the spindle, relative to its length, as a mean over the orientations."""
TABLE_BELOW_MM = 20.0
"""Distance of the table from the last point that the stylus or, with a horizontal spindle, the ram reaches."""
FULL_ELEVATION_DEG = 45.0
BEFORE_TOUCH_MM = 8.0 + MOUNT_ALLOWANCE_MM
"""Travel in front of the contact with a ball that its first touch needs (`procedure.wide_approach_mm`)."""


@dataclass(frozen=True)
class MountSize:
    """Dimensions of a rotary mount in mm: shaft, radius and head of the pedestal, and the least height of the elevation
    axis above the table. The shaft is so long that the artefact passes the pedestal at an elevation of 45°."""

    shaft_mm: float
    pedestal_radius_mm: float
    head_mm: float
    height_mm: float


MOUNT_SIZES = (
    (800.0, MountSize(120.0, 50.0, 30.0, 120.0)),
    (300.0, MountSize(80.0, 40.0, 25.0, 80.0)),
    (0.0, MountSize(50.0, 25.0, 15.0, 50.0)),
)
"""Proposed mount by the least size of its artefact in mm."""


@dataclass(frozen=True)
class StationSetup:
    """Stations of the mount, and the orientations in which the artefact is measured at each.

    `places_mm` are points of the azimuth axis at the height of the middle of the artefact, workpiece frame.
    `table_z_mm` is the height of the table surface, `shaft_mm` the distance from the azimuth axis to the axis of the
    bar. The pedestal of the mount has the radius `pedestal_radius_mm` and ends `head_mm` above the place.
    `elevation_deg` is the elevation of the inclined orientations. If the artefact is placed `by_hand`, there is no
    mount: its dimensions are 0, and the places are those of the origin of the artefact frame. The tip then looks for it
    at `search_feed_mm_per_min`; None stands for the default of the settings.
    """

    places_mm: tuple[Triple, ...]
    shaft_mm: float
    table_z_mm: float
    pedestal_radius_mm: float
    head_mm: float
    elevation_deg: float
    origins: Mapping[str, str]
    by_hand: bool = False
    search_feed_mm_per_min: float | None = None


def propose_stations(
    machine: MachineSetup,
    artefact: ArtefactSetup,
    *,
    count: int | None = None,
    first_mm: Triple | None = None,
    shaft_mm: float | None = None,
    table_z_mm: float | None = None,
    least_inset_mm: float = 0.0,
) -> StationSetup:
    """Return the stations along the longest horizontal axis, each with the artefact in the middle of the other travels.

    `count`, `first_mm` (place of the mount at station 1), `shaft_mm` and `table_z_mm` replace proposals. The other
    stations have the same coordinates as the first across their axis, and are spread over the rest of the travel, at
    least `least_inset_mm` from its ends or in its middle.
    """
    mount = propose_mount(artefact)
    shaft = mount.shaft_mm if shaft_mm is None else shaft_mm
    along = _station_axis(machine)
    middle = first_mm or _middle(machine, artefact, shaft, mount, table_z_mm)
    low, high = machine.stylus_range(along)
    inset = min(max(0.5 * END_SHARE * artefact.size_mm, least_inset_mm), 0.5 * (high - low))
    number = count or min(MOST_STATIONS, max(2, math.ceil(OVERLAP * (high - low) / artefact.size_mm)))
    first, last = low + inset, high - inset
    if first_mm is not None:
        steps = _around(first_mm[along], first, last, number - 1)
    else:
        steps = [0.5 * (low + high)] if number == 1 else np.linspace(first, last, number).tolist()
    others = [_replaced(middle, along, round(value)) for value in steps]
    places = tuple(others if first_mm is None else (first_mm, *others))
    return StationSetup(
        places_mm=places,
        shaft_mm=shaft,
        table_z_mm=_table_height(machine, middle[VERTICAL], mount) if table_z_mm is None else table_z_mm,
        pedestal_radius_mm=mount.pedestal_radius_mm,
        head_mm=mount.head_mm,
        elevation_deg=_elevation(machine, artefact),
        origins={
            "places_mm": PROPOSED if first_mm is None else STATED,
            "table_z_mm": PROPOSED if table_z_mm is None else STATED,
        },
    )


def check_place(machine: MachineSetup, artefact: ArtefactSetup, place_mm: Triple) -> None:
    """Raise DataError if an artefact whose mount stands at `place_mm` is beyond the reach of the stylus, along the axis
    of the stations, with all of its balls."""
    axis = _station_axis(machine)
    low, high = machine.stylus_range(axis)
    if not low - 0.5 * artefact.size_mm < place_mm[axis] < high + 0.5 * artefact.size_mm:
        raise DataError(
            f"a mount at {AXES[axis]} = {place_mm[axis]:g} mm is beyond the reach of the stylus, which is {low:g} to "
            f"{high:g} mm there",
            hint="state the place in the workpiece frame: axis position plus tool offset, in mm",
            axis=AXES[axis],
        )


def propose_mount(artefact: ArtefactSetup) -> MountSize:
    """Return the dimensions of a mount that carries the artefact."""
    return next(size for length, size in MOUNT_SIZES if artefact.size_mm >= length)


def orientations(spindle: ProbeFrame, elevation_deg: float, *, is_bar: bool = True) -> tuple[tuple[float, float], ...]:
    """Return azimuth and elevation in degrees of the proposed orientations.

    A bar lies along the diagonals of the three planes, as in set S3 but with the given elevation, and along X, Y and Z
    as far as they can be reached. The face of a plate or tetrahedron that carries the balls is turned to both sides by
    as much as the stylus still reaches them. In front of a horizontal spindle, the azimuth turns it, and the elevation
    turns it in its own plane; azimuths are counted from the one at which the holders point against the spindle.
    """
    e = elevation_deg
    pairs: tuple[tuple[float, float], ...]
    if is_bar:
        pairs = ((45.0, 0.0), (-45.0, 0.0), (0.0, e), (0.0, -e), (90.0, e), (90.0, -e), (0.0, 0.0), (90.0, 0.0))
    elif spindle.is_vertical:
        pairs = ((0.0, 0.0), (45.0, 0.0), (0.0, e), (0.0, -e), (90.0, e), (90.0, -e), (45.0, e), (-45.0, e))
    else:
        pairs = ((0.0, 0.0), (0.0, e), (45.0, 0.0), (-45.0, 0.0), (45.0, e), (-45.0, -e), (30.0, -e), (-30.0, e))
    return tuple((_wrapped(spindle.facing_deg + azimuth), elevation) for azimuth, elevation in pairs)


def positions_of(stations: StationSetup, spindle: ProbeFrame, *, is_bar: bool = True) -> tuple[Position, ...]:
    """Return all orientations at all stations."""
    return tuple(
        Position(station, azimuth, elevation)
        for station in range(1, len(stations.places_mm) + 1)
        for azimuth, elevation in orientations(spindle, stations.elevation_deg, is_bar=is_bar)
    )


def station_axis(machine: MachineSetup) -> str:
    """Return the letter of the axis along which the stations stand."""
    return AXES[_station_axis(machine)]


def outer_stations(machine: MachineSetup, stations: StationSetup) -> tuple[int, ...]:
    """Return the numbers of the stations nearest to the ends of the travel along which they stand."""
    axis = _station_axis(machine)
    values = [place[axis] for place in stations.places_mm]
    return tuple(sorted({values.index(min(values)) + 1, values.index(max(values)) + 1}))


def _around(stated: float, first: float, last: float, count: int) -> list[float]:
    """Return `count` further places along an axis between `first` and `last`, in ascending order, that are evenly
    spaced on each side of the stated one.

    Their numbers on both sides are those with which the farthest point of the axis is nearest to a station.
    """

    def spread(below: int) -> tuple[float, list[float]]:
        lower = np.linspace(first, stated, below + 1)[:-1].tolist()
        upper = np.linspace(stated, last, count - below + 1)[1:].tolist()
        places = sorted((stated, *lower, *upper))
        gaps = [0.5 * (after - before) for before, after in pairwise(places)]
        return max(places[0] - first, last - places[-1], *gaps), [*lower, *upper]

    if not first < stated < last:
        return spread(0 if stated <= first else count)[1]
    return min(map(spread, range(count + 1)))[1]


def _station_axis(machine: MachineSetup) -> int:
    return max(machine.spindle.horizontal_across, key=lambda axis: machine.travel_mm[axis])


def _middle(
    machine: MachineSetup, artefact: ArtefactSetup, shaft_mm: float, mount: MountSize, table_z_mm: float | None
) -> Triple:
    """Return the place of the mount at which the artefact is in the middle of the volume that the stylus reaches.

    Along the spindle it is farther away by most of the shaft, which holds the artefact before or above the mount, and
    by part of the holders. On a flat machine with a vertical spindle, which inclines the artefact little, it is nearly
    all of both. The place is not so low that the mount does not fit between it and a stated table.
    """
    place = [0.5 * sum(machine.stylus_range(axis)) for axis in range(3)]
    spindle = machine.spindle
    steepness = _elevation(machine, artefact) / FULL_ELEVATION_DEG if spindle.is_vertical else 1.0
    along = 1.0 - (1.0 - SHAFT_TOWARDS_SPINDLE) * steepness
    place[spindle.axis] += spindle.sign * along * (shaft_mm + (1.0 - 0.5 * steepness) * artefact.depth_mm)
    place[spindle.axis] += spindle.sign * _touch_shift_mm(machine, artefact)
    if table_z_mm is not None:
        up = -1.0 if points_up(spindle) else 1.0
        place[VERTICAL] = up * max(up * place[VERTICAL], up * table_z_mm + mount.height_mm)
    return float(round(place[0])), float(round(place[1])), float(round(place[2]))


def _touch_shift_mm(machine: MachineSetup, artefact: ArtefactSetup) -> float:
    """Return how far beyond the middle of a short travel the artefact has to stand, seen from the spindle, in mm.

    A touch begins in front of a ball, so it needs travel on the side of the spindle and hardly any on the other. The
    shift is as long as the outermost balls need at the proposed elevation, and 0 if the travel is long enough or
    horizontal.
    """
    if not machine.spindle.is_vertical:
        return 0.0
    half_mm = 0.5 * machine.travel_mm[VERTICAL]
    inclined = math.sin(math.radians(_elevation(machine, artefact)))
    before_mm = 0.5 * artefact.diameter_mm + machine.probe["tip_radius_mm"] + BEFORE_TOUCH_MM
    needed_mm = 0.5 * artefact.size_mm * inclined + before_mm - half_mm
    free_mm = half_mm - MOUNT_ALLOWANCE_MM - 0.5 * artefact.size_mm * inclined
    return max(0.0, min(needed_mm, max(free_mm, 0.5 * (before_mm - MOUNT_ALLOWANCE_MM))))


def _table_height(machine: MachineSetup, place_mm: float, mount: MountSize) -> float:
    """Return the height of a table beyond everything that the stylus or, with a horizontal spindle, the ram reaches,
    and so far from the place of the mount that this has room. The mount hangs from it if the stylus points upwards."""
    low, high = machine.stylus_range(VERTICAL)
    if points_up(machine.spindle):
        return float(math.ceil(max(high + TABLE_BELOW_MM, place_mm + mount.height_mm)))
    beside = 0.0 if machine.spindle.is_vertical else machine.kind.ram_half_width_mm
    return float(math.floor(min(low - beside - TABLE_BELOW_MM, place_mm - mount.height_mm)))


def _elevation(machine: MachineSetup, artefact: ArtefactSetup) -> float:
    """Return the largest elevation up to 45° at which the artefact fits into the vertical travel, in whole degrees."""
    share = max(machine.travel_mm[VERTICAL] - TOUCHED_MM, 0.0) / artefact.size_mm
    return float(min(FULL_ELEVATION_DEG, max(10.0, math.floor(math.degrees(math.asin(min(1.0, share)))))))


def _replaced(place: Triple, axis: int, value: float) -> Triple:
    changed = list(place)
    changed[axis] = float(value)
    return changed[0], changed[1], changed[2]


def _wrapped(angle_deg: float) -> float:
    return (angle_deg + 180.0) % 360.0 - 180.0
