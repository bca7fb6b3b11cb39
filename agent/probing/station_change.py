"""Change from one station to the next. The operator carries the mount or the artefact, unless every station has a mount
and an artefact of its own."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum
from typing import Protocol

import numpy as np

from agent.execution.steps import AskOperator, CheckPermissions, MoveTo, OrientTo, Plan, Point, ReadPosition
from drivers.roles import OperatorRequest, OperatorTask
from twin.arrays import Array


class CarriedItem(Enum):
    """Item that the operator carries to the next station."""

    MOUNT = "Put the artefact and its mount at station {}, clamp it, clear the workspace, close the doors."
    ARTEFACT = "Put the artefact on the mount at station {}, clamp it, clear the workspace, close the doors."
    NOTHING = ""


class RetreatLocations(Protocol):
    """Interface of an object that gives axis positions at which the probe is clear of all turning bodies."""

    def at_retreat_plane(self, position: Array) -> Array: ...

    def park_location(self, position: Array, station: int) -> Array: ...


@dataclass(frozen=True)
class StationChange:
    """Rules for a change of station.

    `own_mounts` lists the stations that have a mount of their own; it is empty if a single mount is carried.
    `parked_deg` holds the azimuth and elevation of a station's own mount while another station is measured.
    """

    carried: CarriedItem = CarriedItem.MOUNT
    own_mounts: tuple[int, ...] = ()
    parked_deg: tuple[float, float] = (0.0, 90.0)

    @property
    def moves_artefact(self) -> bool:
        """True if the operator carries the artefact from station to station. In this case, the pose of the artefact may
        differ each time it is put at a station."""
        return self.carried is not CarriedItem.NOTHING


def change_station(
    prefix: str,
    change: StationChange,
    locations: RetreatLocations,
    here: Array,
    *,
    leaving: int | None,
    to: int,
    index: int,
) -> Plan[Array]:
    """Park the mount of the station `leaving`, ask the operator to carry the mount or the artefact, and check that
    motion is permitted. The operator is not asked if nothing has to be carried.

    The probe may start at any place clear of all bodies. The result is the axis positions (3,) at the end. They are
    read after the question, because a person who carries a mount may have jogged the axes to make room.
    """
    if leaving is not None and change.own_mounts:
        here = yield from park_mounts(prefix, f"change-{index}", change, locations, here, (leaving,))
    if change.carried is CarriedItem.NOTHING:
        return here
    request = OperatorRequest(OperatorTask.MOVE_ARTEFACT, change.carried.value.format(to), to)
    yield AskOperator(f"{prefix}/carry-{index}-to-station-{to}", request)
    yield CheckPermissions(f"{prefix}/carry-{index}/permissions")
    return np.array((yield ReadPosition(f"{prefix}/carry-{index}/here")))


def park_mounts(
    prefix: str, when: str, change: StationChange, locations: RetreatLocations, here: Array, stations: Sequence[int]
) -> Plan[Array]:
    """Turn the mounts at `stations` to their parked angles; return the axis positions (3,) at the end. While a mount
    turns, the probe waits beside the station, clear of the mount."""
    for station in stations:
        key = f"{prefix}/station-{station}/{when}"
        yield MoveTo(f"{key}/retreat", _point(locations.at_retreat_plane(here)))
        here = locations.park_location(here, station)
        yield MoveTo(f"{key}/beside", _point(here))
        yield OrientTo(f"{key}/park", station, *change.parked_deg)
    return here


def _point(position: Array) -> Point:
    x, y, z = position.tolist()
    return x, y, z
