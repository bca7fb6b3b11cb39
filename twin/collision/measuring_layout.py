"""Where an artefact can stand, which of its balls lie inside the travel, and which the probe gets at."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from twin.arrays import Array
from twin.artefact.artefact import Artefact
from twin.artefact.position_set import MountGeometry, Position, is_reachable, mount_pose
from twin.collision.accessibility import FIVE_TOUCHES, accessible_balls, measuring_scene
from twin.collision.bodies import Body, ProbeGeometry
from twin.errors import DataError

Mask = NDArray[np.bool_]
_Standing = tuple[float, float, float, float, int]


@dataclass(frozen=True, eq=False)
class MeasuringLayout:
    """The places of an artefact before a machine, for one tool.

    `locations_mm`: station number → (3,) foot of the mount in the workpiece frame. `lower_mm`, `upper_mm` (3,): travel
    less what touching needs of it. `contact_mm`: ball and tip radius together; `approach_mm`: how far outside contact
    a touch begins, `overtravel_mm`: how far behind it comes to rest; `directions` (k, 3): along which every ball is
    touched.

    `artefact`: that by which observations count their balls. Where each station has its own, `own_artefacts` holds them
    and `artefact` is all of them, joined in the order of the stations. `around`: station → bodies of other mounts,
    and of what they carry, that stand in the workspace while it is measured there.
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
    # What is in the way depends on orientation, depth and height alone, unless more than one mount stands there; asking
    # is dear, and every position is asked for more than once.
    _accessible: dict[_Standing, Mask] = field(default_factory=dict, init=False, repr=False)

    def nominal(self, position: Position) -> Array:
        """Axis positions (N, 3) of all balls of the artefact at `position` when the mount stands where it is said to
        stand."""
        azimuth, elevation = math.radians(position.azimuth_deg), math.radians(position.elevation_deg)
        pose = mount_pose(self.location(position.station), self.mount, azimuth, elevation)
        return pose.apply(self.artefact_at(position.station).balls) - self.tool_offset_mm

    def reachable(self, position: Position, predicted: Array) -> Mask:
        """(N,): balls of `position` inside the travel with nothing in the way."""
        inside = is_reachable(predicted, self.lower_mm, self.upper_mm, np.zeros(3))
        return np.logical_and(inside, self.accessible(position))

    def accessible(self, position: Position) -> Mask:
        """(N,): balls of `position` where nothing of artefact or mount stands in the way of the probe."""
        place = self.location(position.station)
        further = self.neighbours.get(position.station, ())
        among = position.station if further else 0
        key = (position.azimuth_deg, position.elevation_deg, float(place[1]), float(place[2]), among)
        if key not in self._accessible:
            centres, scene = measuring_scene(
                self.artefact_at(position.station),
                self.probe,
                self.mount,
                location_mm=place,
                azimuth_rad=math.radians(position.azimuth_deg),
                elevation_rad=math.radians(position.elevation_deg),
                further=further,
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
        """What is measured there."""
        return self.own_artefacts.get(station, self.artefact)

    def first_ball(self, station: int) -> int:
        """The number, as observations count, of ball 0 of the artefact at a station."""
        return sum(own.count for number, own in self.own_artefacts.items() if number < station)

    def location(self, station: int) -> Array:
        """(3,) mm. DataError for a station that has none."""
        if station not in self.locations_mm:
            known = ", ".join(str(number) for number in sorted(self.locations_mm))
            raise DataError(f"station {station} has no place", hint=f"stations with a place: {known}")
        return self.locations_mm[station]
