"""Bodies at neighbouring stations that are in the workspace while one station is measured.

They are the mounts of the other stations and the artefacts on these mounts.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace

from twin.arrays import Array
from twin.artefact.artefact import Artefact
from twin.artefact.mount_geometry import MountGeometry
from twin.artefact.position_set import mount_pose
from twin.collision.bodies import Body, artefact_bodies, mount_bodies


def neighbour_bodies(
    geometry: MountGeometry,
    locations_mm: Mapping[int, Array],
    own_artefacts: Mapping[int, Artefact],
    parked_deg: tuple[float, float],
) -> dict[int, tuple[Body, ...]]:
    """Return a mapping from each station to the bodies at all other stations.

    The bodies are the mounts of the other stations and the artefacts on these mounts, turned to the azimuth and the
    elevation `parked_deg` in degrees. The name of each body contains the number of its station.

    If a station has no artefact of its own, its mount is empty. One artefact is then moved from station to station, and
    it is on the mount of the station that is being measured.
    """
    parked = {
        station: _named(station, _parked_bodies(geometry, location, own_artefacts.get(station), parked_deg))
        for station, location in locations_mm.items()
    }
    return {
        station: tuple(body for other, bodies in parked.items() if other != station for body in bodies)
        for station in locations_mm
    }


def _parked_bodies(
    geometry: MountGeometry, location_mm: Array, artefact: Artefact | None, parked_deg: tuple[float, float]
) -> tuple[Body, ...]:
    azimuth, elevation = (math.radians(angle) for angle in parked_deg)
    pose = mount_pose(location_mm, geometry, azimuth, elevation)
    mount = mount_bodies(geometry, location_mm, pose)
    return mount if artefact is None else (*artefact_bodies(artefact, pose), *mount)


def _named(station: int, bodies: tuple[Body, ...]) -> tuple[Body, ...]:
    return tuple(replace(body, name=f"{body.name} at station {station}") for body in bodies)
