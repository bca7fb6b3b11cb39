"""Where an artefact can stand, which of its balls lie inside the travel, and which the probe gets at."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from twin.access import FIVE_TOUCHES, accessible, standing_scene
from twin.arrays import Array
from twin.artefact import Artefact
from twin.bodies import ProbeGeometry
from twin.errors import DataError
from twin.position_set import MountGeometry, Position, mount_pose, reachable

Mask = NDArray[np.bool_]
_Standing = tuple[float, float, float, float]


@dataclass(frozen=True, eq=False)
class Layout:
    """The places of an artefact before a machine, for one tool.

    `places_mm`: station number → (3,) foot of the mount in the workpiece frame. `lower_mm`, `upper_mm` (3,): travel
    less what touching needs of it. `contact_mm`: ball and tip radius together; `approach_mm`: how far outside contact
    a touch begins; `directions` (k, 3): along which every ball is touched.
    """

    artefact: Artefact
    mount: MountGeometry
    probe: ProbeGeometry
    places_mm: Mapping[int, Array]
    tool_offset_mm: Array
    lower_mm: Array
    upper_mm: Array
    contact_mm: float
    approach_mm: float
    directions: Array = field(default_factory=lambda: FIVE_TOUCHES)
    # What is in the way depends on orientation, depth and height alone; asking is dear, and every position is asked for
    # more than once.
    _accessible: dict[_Standing, Mask] = field(default_factory=dict, init=False, repr=False)

    def nominal(self, position: Position) -> Array:
        """Axis positions (N, 3) of all balls of `position` when the mount stands where it is said to stand."""
        azimuth, elevation = math.radians(position.azimuth_deg), math.radians(position.elevation_deg)
        pose = mount_pose(self.place(position.station), self.mount, azimuth, elevation)
        return pose.applied(self.artefact.balls) - self.tool_offset_mm

    def reachable(self, position: Position, predicted: Array) -> Mask:
        """(N,): balls of `position` inside the travel with nothing in the way."""
        inside = reachable(predicted, self.lower_mm, self.upper_mm, np.zeros(3))
        return np.logical_and(inside, self.accessible(position))

    def accessible(self, position: Position) -> Mask:
        """(N,): balls of `position` where nothing of artefact or mount stands in the way of the probe."""
        place = self.place(position.station)
        key = (position.azimuth_deg, position.elevation_deg, float(place[1]), float(place[2]))
        if key not in self._accessible:
            centres, scene = standing_scene(
                self.artefact,
                self.probe,
                self.mount,
                place_mm=place,
                azimuth_rad=math.radians(position.azimuth_deg),
                elevation_rad=math.radians(position.elevation_deg),
            )
            self._accessible[key] = accessible(
                centres,
                scene,
                contact_mm=self.contact_mm,
                approach_mm=self.approach_mm,
                directions=self.directions,
            )
        return self._accessible[key]

    def place(self, station: int) -> Array:
        """(3,) mm. DataError for a station that has none."""
        if station not in self.places_mm:
            known = ", ".join(str(number) for number in sorted(self.places_mm))
            raise DataError(f"station {station} has no place", hint=f"stations with a place: {known}")
        return self.places_mm[station]
