"""Solid parts of an artefact besides its balls: the holders of the balls, the beam of a bar, and any other parts.

All parts are rods with round ends in the artefact frame. A rod that turns with the artefact remains a rod, whereas the
faces of a box would no longer be perpendicular to the machine axes. A box is therefore covered by parallel rods.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from twin.arrays import Array
from twin.errors import DataError

Vector = tuple[float, float, float]

# weight over stiffness ρ g / E in 1/mm: 1600 kg/m³, 9.81 m/s², 120 GPa
_CARBON_FIBRE_PER_MM = 1600e-9 * 9.81 / 120e3
_RESERVED_NAMES = ("tip", "stem", "ram", "table", "shaft", "pedestal", "ball", "post")


@dataclass(frozen=True)
class Rod:
    """Straight rod with round ends. Its points are within `radius_mm` of the line from `start_mm` to `end_mm`, which
    are points of the artefact frame in mm.
    """

    name: str
    start_mm: Vector
    end_mm: Vector
    radius_mm: float

    @property
    def line(self) -> tuple[Array, Array, float, float]:
        """Line of the rod: its point (3,) nearest to the origin of the artefact frame, its unit vector (3,) from start
        to end, and the coordinates in mm of start and end along it, from this point. The vector is zero if start and
        end coincide.
        """
        start, end = np.array(self.start_mm), np.array(self.end_mm)
        axis = (end - start) / max(float(np.linalg.norm(end - start)), 1e-9)
        return start - (start @ axis) * axis, axis, float(start @ axis), float(end @ axis)

    def points(self, count: int) -> Array:
        """Return `count` + 1 evenly spaced points (count + 1, 3) in mm on the axis of the rod, both ends included."""
        base, axis, first, last = self.line
        return np.asarray(base + np.linspace(first, last, count + 1)[:, None] * axis)


@dataclass(frozen=True)
class Beam:
    """Straight beam of a ball bar along the X axis of the artefact frame. It extends `overhang_mm` beyond the feet of
    the end balls and has the radius `radius_mm`.
    """

    radius_mm: float = 15.0
    overhang_mm: float = 15.0

    def own_sag_mm(self, half_length_mm: float) -> float:
        """Return the distance in mm by which the ends of a horizontal tube of carbon fibre hang below its clamped
        middle under its own weight: two cantilevers of the length L with the radius r, ρ g L⁴ / (4 E r²)."""
        return _CARBON_FIBRE_PER_MM * half_length_mm**4 / (4.0 * self.radius_mm**2)


@dataclass(frozen=True)
class ArtefactBody:
    """Solid parts of an artefact with N balls, besides the balls.

    Each ball stands on a holder (post), a rod of radius `holder_radius_mm` from its foot to the centre of the ball.
    `feet_mm` contains the N feet in mm in the artefact frame. If it is None, each foot is the point of the X axis that
    is closest to its ball, as on a bar. `beam` is the beam of a bar, None for any other artefact. `parts` contains
    further parts.
    """

    holder_radius_mm: float = 4.0
    feet_mm: tuple[Vector, ...] | None = None
    beam: Beam | None = Beam()
    parts: tuple[Rod, ...] = ()

    def feet(self, balls: Array) -> Array:
        """Return the feet (N, 3) in mm of the holders of `balls` (N, 3)."""
        if self.feet_mm is not None:
            return np.array(self.feet_mm)
        feet = balls.copy()
        feet[:, 1:] = 0.0
        return feet

    def carriers(self, balls: Array) -> tuple[Rod, ...]:
        """Return the beam and the further parts, which carry the holders of `balls` (N, 3)."""
        if self.beam is None:
            return self.parts
        along = self.feet(balls)[:, 0]
        first, last = float(along.min()) - self.beam.overhang_mm, float(along.max()) + self.beam.overhang_mm
        return (Rod("bar", (first, 0.0, 0.0), (last, 0.0, 0.0), self.beam.radius_mm), *self.parts)


def vector(values: Array | Sequence[float]) -> Vector:
    """Return three numbers as a tuple of plain floats."""
    x, y, z = (float(value) for value in values)
    return x, y, z


def cover_box(name: str, lower_mm: Vector, upper_mm: Vector) -> tuple[Rod, ...]:
    """Return parallel rods that together enclose the box from the corner `lower_mm` to the corner `upper_mm`.

    The rods are parallel to the longest edge of the box and lie side by side along the second edge. With the thickness
    t of the box (its shortest edge), the distance s ≤ t between two rods and the radius √(t² + s²) / 2, they protrude
    from the large faces by at most 0.21 t and from the ends by at most 0.71 t. Raises DataError if a corner is not
    below the other.
    """
    low, high = np.array(lower_mm), np.array(upper_mm)
    if not (low < high).all():
        raise DataError(f"part '{name}' needs a lower corner below its upper corner on every axis")
    size = high - low
    thin, wide, long = (int(axis) for axis in np.argsort(size, kind="stable"))
    count = math.ceil(size[wide] / size[thin])
    width = size[wide] / count
    start, end = 0.5 * (low + high), 0.5 * (low + high)
    start[long], end[long] = low[long], high[long]
    rods = []
    for number in range(count):
        start[wide] = end[wide] = low[wide] + (number + 0.5) * width
        rods.append(Rod(name, vector(start), vector(end), 0.5 * math.hypot(size[thin], width)))
    return tuple(rods)


def check_part_name(name: str) -> None:
    """Raise DataError if a part of an artefact has the name of a body of the probe, the mount, a ball or a holder."""
    if name.split(" ", maxsplit=1)[0] in _RESERVED_NAMES:
        raise DataError(
            f"a part of the artefact cannot be named '{name}'",
            hint=f"reserved words are: {', '.join(_RESERVED_NAMES)}",
        )
