"""From one station to the next: the operator carries something, or every station has all it needs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum
from typing import Protocol

from agent.execution.steps import AskOperator, CheckPermissions, MoveTo, OrientTo, Plan, Point
from drivers.roles import OperatorRequest, OperatorTask
from twin.arrays import Array


class CarriedItem(Enum):
    """What a person carries to the next station."""

    MOUNT = "Put the artefact and its mount at station {}, clamp it, clear the workspace, close the doors."
    ARTEFACT = "Put the artefact on the mount at station {}, clamp it, clear the workspace, close the doors."
    NOTHING = ""


class RetreatLocations(Protocol):
    """Where the probe is out of the way of what turns."""

    def retreated(self, position: Array) -> Array: ...

    def parked(self, position: Array, station: int) -> Array: ...


@dataclass(frozen=True)
class StationChange:
    """`own_mounts`: stations with a mount of their own, which stands at azimuth and elevation `parked_deg` while
    another one is measured; empty for one mount that is carried."""

    carried: CarriedItem = CarriedItem.MOUNT
    own_mounts: tuple[int, ...] = ()
    parked_deg: tuple[float, float] = (0.0, 90.0)

    @property
    def moves_artefact(self) -> bool:
        """Whether an artefact stands elsewhere than it was found before, once it has been at another station."""
        return self.carried is not CarriedItem.NOTHING


def change_station(
    prefix: str, change: StationChange, ways: RetreatLocations, here: Array, *, leaving: int | None, to: int, index: int
) -> Plan[Array]:
    """Park the mount that is left, where it stays; have the operator carry what is carried, and see that motion is
    permitted again. Begins with the probe anywhere free; the axis positions afterwards."""
    if leaving is not None and change.own_mounts:
        here = yield from park_mounts(prefix, f"change-{index}", change, ways, here, (leaving,))
    if change.carried is CarriedItem.NOTHING:
        return here
    request = OperatorRequest(OperatorTask.MOVE_ARTEFACT, change.carried.value.format(to), to)
    yield AskOperator(f"{prefix}/carry-{index}-to-station-{to}", request)
    yield CheckPermissions(f"{prefix}/carry-{index}/permissions")
    return here


def park_mounts(
    prefix: str, when: str, change: StationChange, ways: RetreatLocations, here: Array, stations: Sequence[int]
) -> Plan[Array]:
    """Turn the mounts at `stations` to where they are in nobody's way, the probe beside each; where that is then."""
    for station in stations:
        key = f"{prefix}/station-{station}/{when}"
        yield MoveTo(f"{key}/retreat", _point(ways.retreated(here)))
        here = ways.parked(here, station)
        yield MoveTo(f"{key}/beside", _point(here))
        yield OrientTo(f"{key}/park", station, *change.parked_deg)
    return here


def _point(position: Array) -> Point:
    x, y, z = position.tolist()
    return x, y, z
