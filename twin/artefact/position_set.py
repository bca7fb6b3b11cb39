"""Position sets of the artefact, poses of the bar on its mount, and the check that balls are within the travel.

The azimuth of the mount is an angle about Z, measured from +X. Its elevation is the angle above the XY plane. If both
are 0, the bar is parallel to X, and its holders point along -Y towards the approaching probe.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from twin.arrays import Array
from twin.artefact.mount_geometry import MountGeometry
from twin.errors import DataError, TwinError

MIN_BALLS = 3
"""Minimum number of balls per position. Fewer balls give no information, since the pose has six unknowns."""

CHECKABLE_BALLS = 5
"""Smallest number of balls of a position among which a wrong one can be told from the others: without it, one ball more
than the pose needs remains."""

SPACE_DIAGONAL_DEG = 35.264
"""Elevation in degrees of the space diagonal of a cube, atan(1/√2)."""

POSITION_SETS: dict[str, tuple[tuple[float, float], ...]] = {
    "S1": ((0.0, 0.0), (90.0, 0.0), (0.0, 90.0)),
    "S2": tuple((az, el) for el in (SPACE_DIAGONAL_DEG, -SPACE_DIAGONAL_DEG) for az in (45.0, -45.0)),
    "S3": ((45.0, 0.0), (-45.0, 0.0), (0.0, 45.0), (0.0, -45.0), (90.0, 45.0), (90.0, -45.0)),
}
"""Pairs (azimuth, elevation) in degrees of each set: S1 along the axes, S2 along the space diagonals, S3 along the two
crossing face diagonals of each of the planes XY, ZX and YZ.
"""
SET_EXPRESSIONS = tuple(
    "+".join(names) for size in range(1, len(POSITION_SETS) + 1) for names in combinations(POSITION_SETS, size)
)
"""Expressions of all combinations of the sets, such as `S1+S3`."""


@dataclass(frozen=True)
class Position:
    """Orientation of the artefact at one station, and the name of the tool for its measurement. Stations are counted
    from 1.

    If the tool is None, the tool of the run is used. `balls` are the numbers of the balls that are measured, counted
    from 0; it is None if all balls within reach are measured. Positions that differ only in their balls are equal.
    """

    station: int
    azimuth_deg: float
    elevation_deg: float
    tool: str | None = None
    balls: tuple[int, ...] | None = field(default=None, compare=False)

    def __post_init__(self) -> None:
        if self.balls is not None and (
            len(self.balls) < MIN_BALLS or self.balls != tuple(sorted({ball for ball in self.balls if ball >= 0}))
        ):
            raise DataError(
                f"the balls {' '.join(map(str, self.balls))} are not at least {MIN_BALLS} different numbers from 0, "
                "in rising order",
                hint="fewer balls do not determine the pose of the artefact",
                station=self.station,
            )
        if self.station < 1:
            raise DataError(f"stations count from 1, got {self.station}")
        if not (abs(self.azimuth_deg) <= 180.0 and abs(self.elevation_deg) <= 90.0):
            raise DataError(
                f"azimuth {self.azimuth_deg} / elevation {self.elevation_deg} is outside ±180° / ±90°",
                station=self.station,
            )


@dataclass(frozen=True, eq=False)
class Pose:
    """Rigid transform from the artefact frame to the workpiece frame.

    The transform maps a point b of the artefact frame to `centre` + `rotation` · b in the workpiece frame, in mm.
    """

    centre: Array
    rotation: Array

    def apply(self, points: Array) -> Array:
        """Transform points (n, 3) in mm from the artefact frame to the workpiece frame."""
        return self.centre + points @ self.rotation.T


def parse_position_set(expression: str, stations: int, facing_deg: float = 0.0) -> tuple[Position, ...]:
    """Parse an expression of named position sets, such as `S1` or `S1+S3`, and return its positions at the stations 1
    to `stations`.

    All positions at station 1 come first, then those at station 2, and so on. An orientation that occurs in several
    sets is included only once per station. `facing_deg` is added to the azimuths, see `set_orientations`. Raises
    TwinError if a set name is unknown.
    """
    if stations < 1:
        raise DataError(f"at least one station is needed, got {stations}")
    orientations = [
        pair for name in expression.split("+") for pair in set_orientations(_named_set(name, expression), facing_deg)
    ]
    unique = list(dict.fromkeys(orientations))
    return tuple(Position(station, az, el) for station in range(1, stations + 1) for az, el in unique)


def set_orientations(name: str, facing_deg: float = 0.0) -> tuple[tuple[float, float], ...]:
    """Return the pairs (azimuth, elevation) in degrees of the set called `name`, with `facing_deg` added to the
    azimuths.

    At azimuth 0, the holders of a bar point along -Y, towards a stylus that points along +Y. With `facing_deg` equal to
    90 or -90 they point towards a stylus along -X or +X, and with 180 towards one along -Y. The bar lies along the same
    lines as without it.
    """
    return tuple((_wrapped(azimuth + facing_deg), elevation) for azimuth, elevation in POSITION_SETS[name])


def _wrapped(angle_deg: float) -> float:
    """Return the angle plus or minus a full turn, more than -180° and at most 180°."""
    return angle_deg - 360.0 * math.ceil((angle_deg - 180.0) / 360.0)


def mount_pose(location_mm: Array, geometry: MountGeometry, azimuth_rad: float, elevation_rad: float) -> Pose:
    """Return the pose of the artefact on a mount at `location_mm`.

    The elevation el turns the artefact about its own Y axis, and then the azimuth az turns it about Z. The X axis of
    the artefact frame points along (cos az cos el, sin az cos el, sin el). `location_mm` (3,) is the point where the
    vertical azimuth axis and the elevation axis of the mount meet.
    """
    ca, sa = math.cos(azimuth_rad), math.sin(azimuth_rad)
    ce, se = math.cos(elevation_rad), math.sin(elevation_rad)
    rotation = np.array([[ca * ce, -sa, -ca * se], [sa * ce, ca, -sa * se], [se, 0.0, ce]])
    return Pose(np.asarray(location_mm, dtype=np.float64) + rotation @ np.array(geometry.shaft_vector_mm), rotation)


def station_locations(
    count: int,
    travel_mm: tuple[float, float],
    half_span_mm: float,
    first_other_mm: float,
    second_other_mm: float,
    axis: int = 0,
) -> Array:
    """Return the locations of the mount at `count` stations that are evenly spaced along the machine axis with the
    index `axis`, as an array (count, 3) in mm. The other two coordinates, in ascending order of their axes, are
    `first_other_mm` and `second_other_mm`.

    The first and the last location are `half_span_mm` inside the ends of `travel_mm`.
    """
    low, high = travel_mm[0] + half_span_mm, travel_mm[1] - half_span_mm
    if count < 1 or high < low:
        raise DataError(
            f"{count} station(s) of half span {half_span_mm} mm do not fit into {'XYZ'[axis]} "
            f"{travel_mm[0]}…{travel_mm[1]}"
        )
    along = np.linspace(low, high, count) if count > 1 else np.array([0.5 * (low + high)])
    others = np.tile([first_other_mm, second_other_mm], (count, 1))
    return np.asarray(np.insert(others, axis, along, axis=1))


def is_reachable(ball_axis_positions: Array, lower: Array, upper: Array, margin_mm: Array) -> NDArray[np.bool_]:
    """Return a boolean array with one element for each of n axis positions (n, 3). An element is True if the axis
    position is at least `margin_mm` (3,) inside the travel limits of every axis.

    The margin is needed for the approach to a ball and the retraction from it.
    """
    inside = (ball_axis_positions >= lower + margin_mm) & (ball_axis_positions <= upper - margin_mm)
    return np.asarray(inside.all(axis=1), dtype=np.bool_)


def _named_set(name: str, expression: str) -> str:
    found = name.strip().upper()
    if found not in POSITION_SETS:
        raise TwinError(
            f"unknown position set '{name.strip()}' in '{expression}'",
            hint=f"Known sets: {', '.join(POSITION_SETS)}; combine them as in S1+S3",
        )
    return found
