"""Range of elevations in which an artefact on its mount hits neither the pedestal of the mount nor the machine table.

The azimuth turns the artefact about the axis of the pedestal and above a horizontal table, so it changes none of these
distances. They depend on the elevation and on the height of the mount location above the table alone. A mount passes
all elevations between two positions, so the range is connected and contains the elevation 0.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from twin.arrays import Array
from twin.artefact.artefact import Artefact
from twin.artefact.mount_geometry import MountGeometry

CLEARANCE_MM = 2.0
"""Least distance in mm of the artefact from the pedestal and from the table."""

_STEP_DEG = 1.0
_SPACING_MM = 5.0  # of the points on a rod: distances to the pedestal are then right to 0.1 mm


@dataclass(frozen=True)
class FreeElevations:
    """Range of elevations from `lower_deg` to `upper_deg`, both in degrees, in which the artefact is free.

    `obstacle` is the body that limits the range, "table" or "pedestal"; it is empty if nothing does. If the artefact is
    not even free at the elevation 0, the range is empty, with `lower_deg` greater than `upper_deg`.
    """

    lower_deg: float
    upper_deg: float
    obstacle: str

    def contains(self, elevation_deg: float) -> bool:
        return self.lower_deg <= elevation_deg <= self.upper_deg


def free_elevations(artefact: Artefact, mount: MountGeometry, height_mm: float) -> FreeElevations:
    """Return the range of elevations in which the artefact is free. `height_mm` is the distance of the mount location
    from the machine table: its height above the table or, if the mount hangs, its depth below it.

    An artefact that is within the clearance of the pedestal at the elevation 0 is taken as fastened to the pedestal,
    which is then left out. So is a pedestal
    whose radius is 0.
    """
    points, radii = _points(artefact, mount)
    angles = np.radians(np.arange(-90.0, 90.0 + 0.5 * _STEP_DEG, _STEP_DEG))
    # Elevation turns the artefact about the Y axis of its frame, through the mount location.
    sines, cosines = np.sin(angles)[:, None], np.cos(angles)[:, None]
    x, y, z = points.T
    across, up = x * cosines - z * sines, mount.up * (x * sines + z * cosines)
    above_table = (up - radii).min(axis=1) + height_mm
    # below its head the pedestal is a cylinder, so only the horizontal distance counts; above, the height over the
    # head, too
    beyond_head = np.maximum(up - mount.head_mm, 0.0)
    from_pedestal = np.sqrt(across**2 + y**2 + beyond_head**2) - radii - mount.pedestal_radius_mm
    apart = {"table": above_table, "pedestal": from_pedestal.min(axis=1)}
    middle = len(angles) // 2
    if mount.pedestal_radius_mm == 0.0 or apart["pedestal"][middle] < CLEARANCE_MM:
        del apart["pedestal"]
    hits = {name: distance < CLEARANCE_MM for name, distance in apart.items()}
    hit = np.any(list(hits.values()), axis=0)
    struck = np.flatnonzero(hit)
    # The mount passes all elevations on its way, so the range ends at the first hit on either side of elevation 0.
    below, beyond = struck[struck <= middle], struck[struck >= middle]
    first = int(below.max()) + 1 if below.size else 0
    last = int(beyond.min()) - 1 if beyond.size else len(angles) - 1
    limits = [index for index in (first - 1, last + 1) if 0 <= index < len(angles)]
    obstacle = next((name for index in limits for name, at in hits.items() if at[index]), "")
    lower, upper = (float(index - middle) * _STEP_DEG for index in (first, last))
    return FreeElevations(lower, upper, obstacle)


def _points(artefact: Artefact, mount: MountGeometry) -> tuple[Array, Array]:
    """Return points (n, 3) on the axes of all parts of the artefact and at its ball centres, in mm relative to the
    mount location in the axes of the artefact frame, and the radius (n,) of the part around each point."""
    points, radii = [artefact.balls], [np.full(artefact.count, artefact.ball_radius_mm)]
    for rod in artefact.rods:
        along = rod.points(math.ceil(math.dist(rod.start_mm, rod.end_mm) / _SPACING_MM))
        points.append(along)
        radii.append(np.full(len(along), rod.radius_mm))
    return np.concatenate(points) + mount.shaft_vector_mm, np.concatenate(radii)
