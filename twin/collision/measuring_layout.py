"""Locations of an artefact on a machine, and the balls that are within the travel and accessible to the probe."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from twin.arrays import Array
from twin.artefact.artefact import Artefact
from twin.artefact.mount_geometry import MountGeometry
from twin.artefact.placement_tolerance import PlacementTolerance
from twin.artefact.position_set import Position, is_reachable, mount_pose
from twin.artefact.touch_pattern import approach_directions
from twin.collision.accessibility import accessible_balls, measuring_scene
from twin.collision.bodies import Body
from twin.collision.free_elevations import FreeElevations, free_elevations
from twin.collision.geometry import Point, point
from twin.collision.probe_frame import ProbeFrame
from twin.collision.probe_geometry import ProbeGeometry
from twin.errors import DataError

Mask = NDArray[np.bool_]
_AccessKey = tuple[float, float, Point, int]


def station_axis_of(frame: ProbeFrame, locations_mm: Sequence[Array | Sequence[float]], lengths_mm: Array) -> int:
    """Return the index of the horizontal machine axis, perpendicular to the stylus, along which the stations stand.

    If there are two such axes (the stylus is vertical), it is the one along which the locations (3,) of the stations
    extend further. If they extend equally far along both, it is the one with the longer travel. `lengths_mm` (3,)
    contains the lengths of travel of X, Y and Z.
    """
    extents = np.ptp(np.array(locations_mm), axis=0)
    return max(frame.horizontal_across, key=lambda axis: (extents[axis], lengths_mm[axis]))


@dataclass(frozen=True, eq=False)
class MeasuringLayout:
    """Locations of an artefact on a machine, and the dimensions that determine which balls one tool can measure there.

    - `locations_mm` maps a station number to the location (3,) of the mount in the workpiece frame.
    - `tool_offset_mm` (3,) is the tool offset; its largest component gives the direction of the stylus.
    - `lower_mm` and `upper_mm` (3,) are the travel limits, reduced by the travel needed for touching.
    - `contact_mm` is the ball radius plus the tip radius.
    - `approach_mm` is the distance before the point of contact at which a touch begins.
    - `overtravel_mm` is the distance beyond the point of contact at which a touch stops.
    - `directions` (k, 3) contains the touch directions, which are the same for every ball; None
      stands for the pattern of five touches.
    - `artefact` defines the ball numbers in observations.
    - `own_artefacts` maps a station number to an artefact if each station has its own artefact. `artefact` is then
      their combination in the order of the stations.
    - `placement` states how far an artefact that is placed by hand may stand from its nominal position; it is None if a
      mount holds the artefact.
    - `neighbours` maps a station number to the bodies of all other mounts and of the artefacts on them. These bodies
      are in the workspace while the station is measured.
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
    directions: Array | None = None
    overtravel_mm: float = 0.0
    own_artefacts: Mapping[int, Artefact] = field(default_factory=dict)
    neighbours: Mapping[int, tuple[Body, ...]] = field(default_factory=dict)
    placement: PlacementTolerance | None = None
    # Accessibility does not depend on the location along the station axis, unless there is more than one mount. It is
    # expensive to compute and needed repeatedly for every position, hence the cache.
    _accessible: dict[_AccessKey, Mask] = field(default_factory=dict, init=False, repr=False)
    locating: dict[tuple[float, float, tuple[int, ...]], tuple[int, ...]] = field(
        default_factory=dict, init=False, repr=False
    )
    """Cache of `twin.collision.locating_balls`."""
    _elevations: dict[tuple[int, float], FreeElevations] = field(default_factory=dict, init=False, repr=False)

    @cached_property
    def frame(self) -> ProbeFrame:
        """Probe frame, which gives the direction of the stylus: the machine axis with the largest component of the tool
        offset.
        """
        return ProbeFrame.nearest(self.tool_offset_mm)

    @cached_property
    def station_axis(self) -> int:
        """Index of the machine axis along which the stations stand, see `station_axis_of`.

        A displacement of the mount along this axis changes nothing in the surroundings of the mount, because the table
        has no limits in this direction.
        """
        return station_axis_of(self.frame, list(self.locations_mm.values()), self.upper_mm - self.lower_mm)

    def with_locations(self, locations_mm: Mapping[int, Array]) -> MeasuringLayout:
        """Return the layout with the stations at other places along `station_axis`. What is accessible does not depend
        on them unless there are `neighbours`, so it is not computed again."""
        moved = replace(self, locations_mm=locations_mm)
        if not self.neighbours:
            moved._accessible.update(self._accessible)
            moved._elevations.update(self._elevations)
        return moved

    def across_stations(self, location_mm: Array) -> Point:
        """Return the location (3,) of a mount in mm with the coordinate 0 along the station axis."""
        out = location_mm.copy()
        out[self.station_axis] = 0.0
        return point(out)

    def nominal(self, position: Position) -> Array:
        """Return for each of the N balls of the artefact the axis positions, as an array (N, 3) in mm, at which the
        stylus centre coincides with the ball centre while the artefact is in `position`. The mount is assumed to be at
        its nominal location.
        """
        azimuth, elevation = math.radians(position.azimuth_deg), math.radians(position.elevation_deg)
        pose = mount_pose(self.location(position.station), self.mount, azimuth, elevation)
        return pose.apply(self.artefact_at(position.station).balls) - self.tool_offset_mm

    def reachable(self, position: Position, predicted: Array) -> Mask:
        """Return a boolean array with one element per ball of the artefact in `position`. An element is True if its
        ball is to be measured, is accessible to the probe, and its predicted axis position is within the travel.

        `predicted` (N, 3) contains the predicted axis positions of the N balls in mm.
        """
        inside = is_reachable(predicted, self.lower_mm, self.upper_mm, np.zeros(3))
        within_reach = np.logical_and(inside, self.accessible(position))
        if position.balls is not None:
            within_reach &= np.isin(np.arange(len(within_reach)), position.balls)
        return within_reach

    def asked_balls(self, position: Position) -> int:
        """Return the number of balls that are to be measured in `position`, within reach or not."""
        return self.artefact_at(position.station).count if position.balls is None else len(position.balls)

    def accessible(self, position: Position) -> Mask:
        """Return a boolean array with one element per ball of the artefact in `position`. An element is True if no body
        obstructs the probe at its ball. The bodies are the artefact, the mount, and the bodies at the neighbouring
        stations. No ball is accessible at an elevation at which the artefact itself would hit the table or its mount.

        A ball of an artefact that is placed by hand must be accessible at both ends of the angular tolerance too. Its
        displacement changes nothing, because the probe follows it.
        """
        spread_deg = 0.0 if self.placement is None else self.placement.angle_deg
        azimuths_deg = {position.azimuth_deg + turn * spread_deg for turn in (-1.0, 0.0, 1.0)}
        masks = [self._accessible_at(position, azimuth_deg) for azimuth_deg in sorted(azimuths_deg)]
        return np.asarray(np.logical_and.reduce(masks))

    def _accessible_at(self, position: Position, azimuth_deg: float) -> Mask:
        if not self.elevations(position.station).contains(position.elevation_deg):
            return np.zeros(self.artefact_at(position.station).count, dtype=np.bool_)
        location = self.location(position.station)
        other_bodies = self.neighbours.get(position.station, ())
        among = position.station if other_bodies else 0
        key = (azimuth_deg, position.elevation_deg, self.across_stations(location), among)
        if key not in self._accessible:
            centres, scene = measuring_scene(
                self.artefact_at(position.station),
                self.probe,
                self.mount,
                frame=self.frame,
                location_mm=location,
                azimuth_rad=math.radians(azimuth_deg),
                elevation_rad=math.radians(position.elevation_deg),
                other_bodies=other_bodies,
            )
            self._accessible[key] = accessible_balls(
                centres,
                scene,
                contact_mm=self.contact_mm,
                approach_mm=self.approach_mm,
                directions=self._directions,
                overtravel_mm=self.overtravel_mm,
            )
        return self._accessible[key]

    @property
    def _directions(self) -> Array:
        return approach_directions(5, self.frame.stylus_axis) if self.directions is None else self.directions

    def elevations(self, station: int) -> FreeElevations:
        """Return the range of elevations in which the artefact at `station` hits neither its mount nor the table.

        An artefact that is placed by hand stands on the table; its range is not limited.
        """
        if self.placement is not None:
            return FreeElevations(-90.0, 90.0, "")
        height_mm = self.mount.up * (float(self.location(station)[2]) - self.mount.table_z_mm)
        key = (station if station in self.own_artefacts else 0, height_mm)
        if key not in self._elevations:
            self._elevations[key] = free_elevations(self.artefact_at(station), self.mount, height_mm)
        return self._elevations[key]

    def artefact_at(self, station: int) -> Artefact:
        """Return the artefact that is measured at the given station."""
        return self.own_artefacts.get(station, self.artefact)

    def first_ball(self, station: int) -> int:
        """Return the number of the first ball at a station, as used in observations. Observations count the balls of
        all stations together if each station has its own artefact.
        """
        return sum(own.count for number, own in self.own_artefacts.items() if number < station)

    def location(self, station: int) -> Array:
        """Return the mount location (3,) of a station in mm. Raises DataError if the station has no location."""
        if station not in self.locations_mm:
            known = ", ".join(str(number) for number in sorted(self.locations_mm))
            raise DataError(f"station {station} has no location", hint=f"stations with a location: {known}")
        return self.locations_mm[station]
