"""Geometry of the mount, which is the rotary device that holds the artefact. The geometry has a separate module,
because the settings import it and must not load numpy.
"""

from __future__ import annotations

from dataclasses import dataclass

from twin.errors import DataError


@dataclass(frozen=True)
class MountGeometry:
    """Dimensions in mm of the mount and of the bar on it. They are used to place the bar and to check for collisions.

    `shaft_mm` is the distance between the vertical azimuth axis and the middle of the bar axis, measured in the
    direction of the ball holders. The pedestal stands on the machine table under the azimuth axis. It extends from the
    height `table_z_mm` (surface of the table, in the workpiece frame) to `head_mm` above the mount location, which is
    the point of the azimuth axis at the height of the middle of the bar.
    """

    shaft_mm: float = 120.0
    shaft_radius_mm: float = 20.0
    bar_radius_mm: float = 15.0
    bar_overhang_mm: float = 15.0
    post_radius_mm: float = 4.0
    pedestal_radius_mm: float = 50.0
    head_mm: float = 30.0
    table_z_mm: float = -150.0

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if name != "table_z_mm" and not value >= 0.0:
                raise DataError(f"{name} must be at least 0, got {value}", key=f"mount.{name}")
