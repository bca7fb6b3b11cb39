"""Change from one station to the next: the operator carries mount or artefact, unless every station has its own."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum
from typing import Protocol

from agent.execution.steps import AskOperator, CheckPermissions, MoveTo, OrientTo, Plan, Point
from drivers.roles import OperatorRequest, OperatorTask
from twin.arrays import Array


class CarriedItem(Enum):
    """Item that the operator carries to the next station."""

    MOUNT = "Put the artefact and its mount at station {}, clamp it, clear the workspace, close the doors."
    ARTEFACT = "Put the artefact on the mount at station {}, clamp it, clear the workspace, close the doors."
    NOTHING = ""


class RetreatLocations(Protocol):
    """Provider of axis positions at which the probe is clear of everything that turns."""

    def at_retreat_plane(self, position: Array) -> Array: ...

    def park_location(self, position: Array, station: int) -> Array: ...


@dataclass(frozen=True)
class StationChange:
    """Rules for a station change. `own_mounts`: stations with a mount of their own, empty for a single mount that is
    carried. `parked_deg`: azimuth and elevation of a station's own mount while another station is measured."""

    carried: CarriedItem = CarriedItem.MOUNT
    own_mounts: tuple[int, ...] = ()
    parked_deg: tuple[float, float] = (0.0, 90.0)

    @property
    def moves_artefact(self) -> bool:
        """True if the operator carries the artefact, so that its pose may differ when it returns to a station."""
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
    """Park the mount of the station being left, ask the operator to carry the item, and check that motion is permitted.

    The plan starts with the probe anywhere clear of all bodies and returns the axis positions (3,) at its end.
    """
    if leaving is not None and change.own_mounts:
        here = yield from park_mounts(prefix, f"change-{index}", change, locations, here, (leaving,))
    if change.carried is CarriedItem.NOTHING:
        return here
    request = OperatorRequest(OperatorTask.MOVE_ARTEFACT, change.carried.value.format(to), to)
    yield AskOperator(f"{prefix}/carry-{index}-to-station-{to}", request)
    yield CheckPermissions(f"{prefix}/carry-{index}/permissions")
    return here


def park_mounts(
    prefix: str, when: str, change: StationChange, locations: RetreatLocations, here: Array, stations: Sequence[int]
) -> Plan[Array]:
    """Turn the mounts at `stations` to their parked angles, with the probe at each one's park location; return the axis
    positions (3,) at the end."""
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
