"""Geometry of the mount.

This is a module of its own, because the settings import it without loading numpy.
"""

from __future__ import annotations

from dataclasses import dataclass

from twin.errors import DataError


@dataclass(frozen=True)
class MountGeometry:
    """Dimensions in mm of the mount and of the bar on it, for placing the bar and for collision checks.

    `shaft_mm`: distance, in the direction of the holders, from the vertical azimuth axis to the bar axis, at the middle
    of the bar. The pedestal is under the azimuth axis, from the table (`table_z_mm`, workpiece frame) to `head_mm`
    above the mount location.
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
