"""Mounts and artefacts at the stations.

There are four arrangements:

- One mount with its artefact is carried from station to station.
- Each station has its own mount, and one artefact is carried.
- Each station has its own mount and its own artefact.
- There is no mount, and the operator places the artefact by hand in each position.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from agent.files import translated
from agent.model_files import load_artefact
from agent.probing.hand_placement import HandPlacement
from agent.probing.station_change import CarriedItem, StationChange
from agent.settings.schema import DeviceSettings, RoleSettings, Settings, StationSettings
from drivers.errors import ConfigurationError
from drivers.registry import has_several_mounts
from twin.artefact.artefact import Artefact
from twin.artefact.combined_artefact import combine_artefacts
from twin.artefact.mount_geometry import MountGeometry
from twin.artefact.placement_tolerance import PlacementTolerance
from twin.collision.bodies import Body
from twin.collision.neighbour_stations import neighbour_bodies
from twin.units import S_PER_MIN

LARGEST_PARK_DISTANCE_MM = 1000.0
"""Park distance on a machine with enough travel: no mount that a person can carry reaches this far."""


@dataclass(frozen=True, eq=False)
class Artefacts:
    """Artefacts of a run.

    `all` is one artefact that combines the balls of all artefacts. Its ball numbers are those used in an estimate of
    the machine's errors. `own` maps each station to the artefact that always stands there; it is empty if one artefact
    is carried.
    """

    all: Artefact
    own: Mapping[int, Artefact] = field(default_factory=dict)

    @property
    def kind(self) -> Artefact:
        """One of the artefacts, which represents all of them.

        All artefacts have the same number of balls of the same size.
        """
        return self.own.get(1, self.all)


def load_artefacts(artefact: Path, stations: StationSettings) -> Artefacts:
    """Read the file `artefact` or, if the settings `stations` name an artefact file for each station, these files
    instead.

    Raises ConfigurationError if the artefacts cannot be combined.
    """
    if stations.artefacts is None:
        return Artefacts(load_artefact(artefact))
    own = {number: load_artefact(path) for number, path in enumerate(stations.artefacts, start=1)}
    with translated(ConfigurationError, key="stations.artefacts"):
        return Artefacts(combine_artefacts(list(own.values())), own)


def station_change(roles: RoleSettings, stations: StationSettings) -> StationChange:
    """Return the rules for the change from one station to another: what the operator carries, and the angles of the
    mounts that are not in use.
    """
    if roles.mount is None or isinstance(roles.mount, str):
        return StationChange()
    carried = CarriedItem.ARTEFACT if stations.artefacts is None else CarriedItem.NOTHING
    return StationChange(carried, tuple(sorted(roles.mount)), stations.parked_deg)


def park_distance_mm(chosen: float | None, place_mm: float, travel_mm: tuple[float, float]) -> float:
    """Return the distance in mm from a station at which the probe waits while the mount turns.

    `place_mm` and `travel_mm` are the place of the station and the travel, both along the axis on which the probe moves
    aside. The distance is `chosen`, the one of the settings. If `chosen` is None, it is 1000 mm or, on a machine too
    small for that, all the travel on the wider side of the station, in whole millimetres.
    """
    low, high = travel_mm
    if chosen is not None:
        return chosen
    return min(LARGEST_PARK_DISTANCE_MM, float(math.floor(max(high - place_mm, place_mm - low))))


def bodies_around(
    mount: MountGeometry, stations: StationSettings, change: StationChange, artefacts: Artefacts
) -> Mapping[int, tuple[Body, ...]]:
    """Return a mapping from each station to the solid bodies of the mounts and artefacts that stand at the other
    stations.

    The probe must avoid these bodies while it measures at the station. The mapping is empty if one mount is carried
    from station to station.
    """
    if not change.own_mounts:
        return {}
    places = {number: np.array(place) for number, place in enumerate(stations.places_mm, start=1)}
    return neighbour_bodies(mount, places, artefacts.own, change.parked_deg)


def check_stations(settings: Settings) -> None:
    """Check the settings that assign mounts and artefacts to the stations.

    Raises ConfigurationError, which names the settings key, if they contradict each other.
    """
    named = settings.roles.mount
    if settings.stations.placed_by_hand:
        _refuse_mount(settings)
        return
    if named is None:
        raise ConfigurationError(
            "no device is the mount",
            key="roles.mount",
            hint="name the device that turns the artefact, or set stations.placed_by_hand = true if there is none",
        )
    if isinstance(named, str):
        if settings.stations.artefacts is not None:
            raise ConfigurationError(
                "artefacts of their own need a mount at every station",
                key="stations.artefacts",
                hint="name a mount for each station in roles.mount, or remove stations.artefacts",
            )
        return
    _check_mounts(named, len(settings.stations.places_mm), settings.devices)
    _check_artefacts(settings.artefact, settings.stations)


def _refuse_mount(settings: Settings) -> None:
    """Raise ConfigurationError if the settings contradict an artefact that is placed by hand."""
    if settings.roles.mount is not None:
        raise ConfigurationError(
            "an artefact that is placed by hand has no mount",
            key="roles.mount",
            hint="remove the key, or stations.placed_by_hand",
        )
    if settings.stations.artefacts is not None:
        raise ConfigurationError(
            "an artefact that is placed by hand is the same at all stations",
            key="stations.artefacts",
            hint="remove the key; the file is named by artefact",
        )
    if settings.verification.positions_deg is None:
        raise ConfigurationError(
            "the orientations for the verification must be listed, because only you know how the artefact can stand",
            key="verification.positions_deg",
            hint="list pairs of azimuth and elevation that the position set does not contain",
        )


def hand_placement(settings: Settings) -> HandPlacement | None:
    """Return the rules for an artefact that is placed by hand; None if a mount holds it."""
    stations, tolerance = settings.stations, placement_tolerance(settings.stations)
    if tolerance is None:
        return None
    procedure = settings.procedure
    return HandPlacement(
        tolerance=tolerance,
        attempts=stations.placement_attempts,
        search_feed_mm_per_s=procedure.guarded_feed_mm_per_min / S_PER_MIN,
        touch_feed_mm_per_s=procedure.first_touch_feed_mm_per_min / S_PER_MIN,
    )


def placement_tolerance(stations: StationSettings) -> PlacementTolerance | None:
    """Return the tolerance of an artefact that is placed by hand; None if a mount holds it."""
    if not stations.placed_by_hand:
        return None
    return PlacementTolerance(stations.placement_tolerance_mm, stations.placement_tolerance_deg)


def _check_mounts(named: Mapping[int, str], count: int, devices: Mapping[str, DeviceSettings]) -> None:
    stations = range(1, count + 1)
    for station in stations:
        if station not in named:
            raise ConfigurationError(f"station {station} has no mount", key=f"roles.mount.{station}")
    owner: dict[str, int] = {}
    for station, device in named.items():
        if station not in stations:
            raise ConfigurationError(
                f"there is no station {station}",
                key=f"roles.mount.{station}",
                hint="stations.places_mm has no entry for it",
            )
        first = owner.setdefault(device, station)
        if first != station and not _plays_several(devices, device):
            raise ConfigurationError(
                f"device {device!r} is already the mount of station {first}",
                key=f"roles.mount.{station}",
                hint="each station has a mount of its own, or roles.mount names one that is carried",
            )


def _plays_several(devices: Mapping[str, DeviceSettings], device: str) -> bool:
    known = devices.get(device)
    return known is not None and has_several_mounts(known.driver, device)


def _check_artefacts(artefact: Path, stations: StationSettings) -> None:
    files = stations.artefacts
    if files is None:
        return
    key, places = "stations.artefacts", len(stations.places_mm)
    if len(files) != places:
        raise ConfigurationError(f"{len(files)} artefacts for {places} stations", key=key)
    for number, path in enumerate(files, start=1):
        first = files.index(path) + 1
        if first != number:
            raise ConfigurationError(
                f"stations {first} and {number} have the same artefact {path.name}",
                key=key,
                hint="each bar has its own certificate; for a single bar that is carried remove stations.artefacts",
            )
    if artefact != files[0]:
        raise ConfigurationError(
            f"the artefact is {artefact.name}, that of station 1 is {files[0].name}",
            key="artefact",
            hint="if every station has an artefact of its own, `artefact` is that of the first",
        )
