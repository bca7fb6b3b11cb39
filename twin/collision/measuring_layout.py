"""Locations of an artefact on a machine, and the balls that are inside the travel and accessible to the probe."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from twin.arrays import Array
from twin.artefact.artefact import Artefact
from twin.artefact.mount_geometry import MountGeometry
from twin.artefact.position_set import Position, is_reachable, mount_pose
from twin.collision.accessibility import FIVE_TOUCHES, accessible_balls, measuring_scene
from twin.collision.bodies import Body
from twin.collision.probe_geometry import ProbeGeometry
from twin.errors import DataError

Mask = NDArray[np.bool_]
_AccessKey = tuple[float, float, float, float, int]


@dataclass(frozen=True, eq=False)
class MeasuringLayout:
    """Locations of an artefact on a machine, for one tool.

    `locations_mm`: map from station number to mount location (3,) in the workpiece frame. `lower_mm`, `upper_mm` (3,):
    travel limits minus the travel needed for touching. `contact_mm`: ball radius plus tip radius; `approach_mm`:
    distance outside contact at which a touch begins; `overtravel_mm`: distance beyond contact at which it stops;
    `directions` (k, 3): touch directions for every ball.

    `artefact` defines the ball numbers of observations. If each station has its own artefact, `own_artefacts` contains
    them and `artefact` is their combination in the order of the stations. `neighbours`: map from station number to the
    bodies of the other mounts and their artefacts that are in the workspace while that station is measured.
    """

    artefact: Artefact
    mount: MountGeometry
    probe: ProbeGeometry
    locations_mm: Mapping[int, Array]
    tool_offset_mm: Array
    lower_mm: Array
    upper_mm: Array
    contact_mm: float
    approach_mm: float
    directions: Array = field(default_factory=lambda: FIVE_TOUCHES)
    overtravel_mm: float = 0.0
    own_artefacts: Mapping[int, Artefact] = field(default_factory=dict)
    neighbours: Mapping[int, tuple[Body, ...]] = field(default_factory=dict)
    # Accessibility depends only on orientation, depth and height, unless there is more than one mount. It is expensive
    # to compute and needed repeatedly for every position, hence the cache.
    _accessible: dict[_AccessKey, Mask] = field(default_factory=dict, init=False, repr=False)

    def nominal(self, position: Position) -> Array:
        """Return the axis positions (N, 3) mm of all balls at `position` if the mount is at its nominal location."""
        azimuth, elevation = math.radians(position.azimuth_deg), math.radians(position.elevation_deg)
        pose = mount_pose(self.location(position.station), self.mount, azimuth, elevation)
        return pose.apply(self.artefact_at(position.station).balls) - self.tool_offset_mm

    def reachable(self, position: Position, predicted: Array) -> Mask:
        """Return (N,) bool: True for each ball of `position` that is accessible and whose predicted location,
        `predicted` (N, 3) in mm, is within the travel.
        """
        inside = is_reachable(predicted, self.lower_mm, self.upper_mm, np.zeros(3))
        return np.logical_and(inside, self.accessible(position))

    def accessible(self, position: Position) -> Mask:
        """Return (N,) bool: True for each ball of `position` at which no body (artefact, mount, neighbours) obstructs
        the probe.
        """
        location = self.location(position.station)
        other_bodies = self.neighbours.get(position.station, ())
        among = position.station if other_bodies else 0
        key = (position.azimuth_deg, position.elevation_deg, float(location[1]), float(location[2]), among)
        if key not in self._accessible:
            centres, scene = measuring_scene(
                self.artefact_at(position.station),
                self.probe,
                self.mount,
                location_mm=location,
                azimuth_rad=math.radians(position.azimuth_deg),
                elevation_rad=math.radians(position.elevation_deg),
                other_bodies=other_bodies,
            )
            self._accessible[key] = accessible_balls(
                centres,
                scene,
                contact_mm=self.contact_mm,
                approach_mm=self.approach_mm,
                directions=self.directions,
                overtravel_mm=self.overtravel_mm,
            )
        return self._accessible[key]

    def artefact_at(self, station: int) -> Artefact:
        """Return the artefact measured at the station."""
        return self.own_artefacts.get(station, self.artefact)

    def first_ball(self, station: int) -> int:
        """Return the number that observations use for the first ball of the artefact at a station."""
        return sum(own.count for number, own in self.own_artefacts.items() if number < station)

    def location(self, station: int) -> Array:
        """Return the location (3,) mm of a station; raises DataError if the station has no location."""
        if station not in self.locations_mm:
            known = ", ".join(str(number) for number in sorted(self.locations_mm))
            raise DataError(f"station {station} has no location", hint=f"stations with a location: {known}")
        return self.locations_mm[station]
