"""Place of a workpiece on the table of a machine."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from twin.arrays import Array, as_points
from twin.errors import DataError
from twin.machine.error_model import Ranges
from twin.machine.kinematic_chain import AXES

_SLACK_MM = 1e-6  # points on the edge of the travel leave it by rounding when the tool offset is added and subtracted


@dataclass(frozen=True, eq=False)
class Placement:
    """Place of a workpiece: its origin is at `origin_mm` (3,) of the coordinates of the machine, and it is turned by
    `turned_rad` about Z.

    The coordinates of the machine are the axis positions, for the tip of the tool: a tool with the offset t reaches
    the point p at the axis position p - t.
    """

    origin_mm: Array
    turned_rad: float = 0.0

    @property
    def rotation(self) -> Array:
        """Matrix (3, 3) that takes directions of the workpiece to directions of the machine."""
        c, s = np.cos(self.turned_rad), np.sin(self.turned_rad)
        return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])

    def in_machine(self, points: Array) -> Array:
        """Return points (n, 3) of the workpiece in the coordinates of the machine."""
        return np.asarray(as_points(points, "points of the workpiece") @ self.rotation.T + self.origin_mm)


def outside(axis_positions: Array, ranges_mm: Ranges) -> tuple[str, float, tuple[float, float]] | None:
    """Return the axis, the position in mm and the range of the first axis whose travel the axis positions (n, 3) leave;
    None if all are inside."""
    for axis, values, (low, high) in zip(AXES, axis_positions.T, ranges_mm, strict=True):
        for value in (values.min(), values.max()):
            if not low - _SLACK_MM <= value <= high + _SLACK_MM:
                return axis, float(value), (low, high)
    return None


def check_inside(name: str, axis_positions: Array, ranges_mm: Ranges) -> None:
    """Raise DataError if the feature `name` needs axis positions (n, 3) outside the travel of the axes."""
    left = outside(axis_positions, ranges_mm)
    if left is not None:
        axis, value, (low, high) = left
        raise DataError(
            f"{name} needs {axis} {value:.1f} mm, beyond the identified travel from {low:g} to {high:g} mm",
            hint="Place the workpiece elsewhere, or use a shorter tool",
            axis=axis,
        )
