"""What stands at the stations: one mount that is carried, a mount at each, an artefact at each; what is nonsense."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from agent.files import load_artefact, translated
from agent.probing.station_change import Carried, StationChange
from agent.settings.schema import Settings
from drivers.errors import ConfigurationError
from drivers.registry import has_several_mounts
from twin.artefact.artefact import Artefact
from twin.artefact.combined_artefact import combine_artefacts
from twin.collision.bodies import Body
from twin.collision.neighbour_stations import neighbour_bodies


@dataclass(frozen=True, eq=False)
class Artefacts:
    """`all` that are measured, as an estimate counts their balls; `own`: station → artefact that stays there."""

    all: Artefact
    own: Mapping[int, Artefact] = field(default_factory=dict)

    @property
    def kind(self) -> Artefact:
        """One of them; all have as many balls, of one size."""
        return self.own.get(1, self.all)


def load_artefacts(settings: Settings) -> Artefacts:
    """Read the artefact, or those of the stations. Raises ConfigurationError."""
    if settings.stations.artefacts is None:
        return Artefacts(load_artefact(settings.artefact))
    own = {number: load_artefact(path) for number, path in enumerate(settings.stations.artefacts, start=1)}
    with translated(ConfigurationError, key="stations.artefacts"):
        return Artefacts(combine_artefacts(list(own.values())), own)


def station_change(settings: Settings) -> StationChange:
    """How one gets from station to station."""
    if isinstance(settings.roles.mount, str):
        return StationChange()
    carried = Carried.ARTEFACT if settings.stations.artefacts is None else Carried.NOTHING
    return StationChange(carried, tuple(sorted(settings.roles.mount)), settings.stations.parked_deg)


def bodies_around(settings: Settings, artefacts: Artefacts) -> Mapping[int, tuple[Body, ...]]:
    """Station → what the other stations' mounts put into the probe's way; nothing where one mount is carried."""
    change = station_change(settings)
    if not change.own_mounts:
        return {}
    places = {number: np.array(place) for number, place in enumerate(settings.stations.places_mm, start=1)}
    return neighbour_bodies(settings.mount, places, artefacts.own, change.parked_deg)


def check_stations(settings: Settings) -> None:
    """Raise ConfigurationError, naming the key, for mounts and artefacts that cannot be meant."""
    named = settings.roles.mount
    if isinstance(named, str):
        if settings.stations.artefacts is not None:
            raise ConfigurationError(
                "artefacts of their own need a mount at every station",
                key="stations.artefacts",
                hint="name a mount for each station in roles.mount, or leave stations.artefacts away",
            )
        return
    _check_mounts(settings, named)
    _check_artefacts(settings)


def _check_mounts(settings: Settings, named: Mapping[int, str]) -> None:
    stations = range(1, len(settings.stations.places_mm) + 1)
    for station in stations:
        if station not in named:
            raise ConfigurationError(f"station {station} has no mount", key=f"roles.mount.{station}")
    owner: dict[str, int] = {}
    for station, device in named.items():
        if station not in stations:
            raise ConfigurationError(
                f"there is no station {station}",
                key=f"roles.mount.{station}",
                hint="stations.places_mm has no such place",
            )
        first = owner.setdefault(device, station)
        if first != station and not _plays_several(settings, device):
            raise ConfigurationError(
                f"device {device!r} is the mount of station {first} already",
                key=f"roles.mount.{station}",
                hint="each station has a mount of its own, or roles.mount names one that is carried",
            )


def _plays_several(settings: Settings, device: str) -> bool:
    known = settings.devices.get(device)
    return known is not None and has_several_mounts(known.driver, device)


def _check_artefacts(settings: Settings) -> None:
    files = settings.stations.artefacts
    if files is None:
        return
    key, places = "stations.artefacts", len(settings.stations.places_mm)
    if len(files) != places:
        raise ConfigurationError(f"{len(files)} artefacts for {places} stations", key=key)
    for number, path in enumerate(files, start=1):
        first = files.index(path) + 1
        if first != number:
            raise ConfigurationError(
                f"stations {first} and {number} have the same artefact {path.name}",
                key=key,
                hint="each bar has a certificate of its own; for one that is carried leave stations.artefacts away",
            )
    if settings.artefact != files[0]:
        raise ConfigurationError(
            f"the artefact is {settings.artefact.name}, that of station 1 is {files[0].name}",
            key="artefact",
            hint="where every station has an artefact of its own, `artefact` is that of the first",
        )
