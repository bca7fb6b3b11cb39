"""Change from one station to the next: the operator carries something, or every station has its own equipment."""

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
    """Locations of the probe clear of everything that turns."""

    def at_retreat_plane(self, position: Array) -> Array: ...

    def park_location(self, position: Array, station: int) -> Array: ...


@dataclass(frozen=True)
class StationChange:
    """Rules for a station change. `own_mounts`: stations with a mount of their own, which is turned to azimuth and
    elevation `parked_deg` while another one is measured; empty for a single mount that is carried."""

    carried: CarriedItem = CarriedItem.MOUNT
    own_mounts: tuple[int, ...] = ()
    parked_deg: tuple[float, float] = (0.0, 90.0)

    @property
    def moves_artefact(self) -> bool:
        """True if an artefact that returns to a station may stand differently from before."""
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
    """Park the mount that stays behind, ask the operator to carry the item, and check that motion is permitted again.

    Starts with the probe anywhere free; returns the axis positions (3,) afterwards.
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
    """Turn the mounts at `stations` to their parked angles, the probe beside each; return the axis positions (3,)."""
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
