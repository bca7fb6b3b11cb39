"""Direction of the stylus, and a coordinate frame in which the stylus points along +Y.

The stylus points along a machine axis, in either direction. Geometry that depends on this direction is computed in the
probe frame. The rotation from the workpiece frame to the probe frame permutes the axes and changes signs, so a box
whose faces are perpendicular to the axes remains such a box.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from twin.arrays import Array
from twin.collision.geometry import Box, Capsule, Point, Shape, point
from twin.errors import DataError

VERTICAL = 2
"""Index of the vertical axis Z. The azimuth axis of a mount is parallel to it, and the table is perpendicular to it."""


@dataclass(frozen=True)
class ProbeFrame:
    """Frame whose Y axis is the direction of the stylus, from the ram towards the tip.

    `axis` is the index (0 to 2) of the machine axis to which the stylus is parallel. `sign` is 1 if the stylus points
    along the positive direction of this axis, and -1 if it points along the negative direction. The Z axis of the frame
    points upwards unless the stylus is vertical; the X axis of the frame is then the X axis of the machine.
    """

    axis: int
    sign: int

    @classmethod
    def of(cls, direction: Array | Sequence[float]) -> ProbeFrame:
        """Return the frame of a stylus along the vector `direction` (3,), which is a tool offset or a unit vector.

        Raises DataError if the vector is not parallel to a machine axis.
        """
        values = [float(value) for value in direction]
        along = [index for index, value in enumerate(values) if value != 0.0]
        if len(along) != 1:
            raise DataError(
                f"the tool {values} is not parallel to a machine axis",
                hint="the stylus points along a machine axis, in either direction: exactly one component of the tool "
                "offset differs from 0, such as [0.0, 0.0, -180.0] for a vertical spindle that probes downwards",
            )
        return cls.nearest(values)

    @classmethod
    def nearest(cls, direction: Array | Sequence[float]) -> ProbeFrame:
        """Return the frame of a stylus along the machine axis with the largest component of the vector `direction`
        (3,), such as the offset of a tool whose tip is displaced laterally.
        """
        values = [float(value) for value in direction]
        axis = max(range(3), key=lambda index: abs(values[index]))
        return cls(axis, 1 if values[axis] > 0.0 else -1)

    @cached_property
    def stylus_axis(self) -> Array:
        """Unit vector (3,) of the stylus in the workpiece frame, from the ram towards the tip."""
        axis = np.zeros(3)
        axis[self.axis] = self.sign
        return axis

    @property
    def is_vertical(self) -> bool:
        return self.axis == VERTICAL

    @property
    def across(self) -> tuple[int, int]:
        """Indices of the two machine axes that are perpendicular to the stylus, in ascending order."""
        first, second = (index for index in range(3) if index != self.axis)
        return first, second

    @property
    def horizontal_across(self) -> tuple[int, ...]:
        """Indices of the horizontal machine axes that are perpendicular to the stylus, in ascending order."""
        return tuple(index for index in self.across if index != VERTICAL)

    @property
    def facing_deg(self) -> float:
        """Azimuth of the mount in degrees at which the holders of a bar, which point along -Y at azimuth 0, point
        towards the stylus. It is 0 if the stylus is vertical.
        """
        return {(0, 1): -90.0, (0, -1): 90.0, (1, -1): 180.0}.get((self.axis, self.sign), 0.0)

    def retreat_end(self, limits: Sequence[tuple[float, float]]) -> float:
        """Return the end of travel in mm from which the stylus points into the travel: the lower end of its axis if it
        points along the positive direction, else the upper end. `limits` contains the ends of travel of X, Y and Z.
        """
        low, high = limits[self.axis]
        return low if self.sign > 0 else high

    def withdrawn_corner(self, limits: Sequence[tuple[float, float]]) -> Point:
        """Return the axis positions in mm at the lower end of travel of each axis, but with the stylus withdrawn: its
        axis is at the end of travel from which the stylus points into the travel.
        """
        ends = [low for low, _ in limits]
        ends[self.axis] = self.retreat_end(limits)
        return point(ends)

    @property
    def axes(self) -> tuple[tuple[int, int], ...]:
        """Workpiece axis (0 to 2) and sign of each axis of the probe frame."""
        return tuple(zip(self._sources, self._signs.astype(int).tolist(), strict=True))

    def to_frame(self, vectors: Array) -> Array:
        """Return vectors (..., 3) of the workpiece frame in the probe frame."""
        return np.asarray(vectors[..., list(self._sources)] * self._signs)

    def to_workpiece(self, vectors: Array) -> Array:
        """Return vectors (..., 3) of the probe frame in the workpiece frame."""
        out = np.empty(vectors.shape)
        out[..., list(self._sources)] = vectors * self._signs
        return out

    def shape_in_frame(self, shape: Shape) -> Shape:
        """Return a shape of the workpiece frame in the probe frame. Both frames have the same origin."""
        return _mapped(shape, self._into)

    def shape_in_workpiece(self, shape: Shape) -> Shape:
        """Return a shape of the probe frame in the workpiece frame. Both frames have the same origin."""
        return _mapped(shape, self._out_of)

    def box_in_frame(self, lower: Array, upper: Array) -> tuple[Array, Array]:
        """Return the lower and the upper corner (3,) of a box of the workpiece frame in the probe frame."""
        corners = np.stack([self.to_frame(lower), self.to_frame(upper)])
        return np.asarray(corners.min(axis=0)), np.asarray(corners.max(axis=0))

    @cached_property
    def _rows(self) -> Array:
        """Rotation matrix (3, 3) from the workpiece frame to the probe frame; its rows are the axes of the frame."""
        x_axis, up = np.eye(3)[[0, VERTICAL]]
        if self.is_vertical:
            return np.stack([x_axis, self.stylus_axis, np.cross(x_axis, self.stylus_axis)])
        return np.stack([np.cross(self.stylus_axis, up), self.stylus_axis, up])

    @cached_property
    def _sources(self) -> tuple[int, ...]:
        """Index of the workpiece axis that each axis of the probe frame is parallel to."""
        return tuple(int(index) for index in np.abs(self._rows).argmax(axis=1))

    @cached_property
    def _signs(self) -> Array:
        # Each row has a single component, 1 or -1: the rotation permutes the axes and changes signs, so no point gets
        # rounding errors.
        return np.asarray(self._rows.sum(axis=1))

    def _into(self, p: Point) -> Point:
        return point(self.to_frame(np.array(p)))

    def _out_of(self, p: Point) -> Point:
        return point(self.to_workpiece(np.array(p)))


def _mapped(shape: Shape, rotate: Callable[[Point], Point]) -> Shape:
    if isinstance(shape, Capsule):
        return Capsule(rotate(shape.a), rotate(shape.b), shape.radius)
    a, b = rotate(shape.lower), rotate(shape.upper)
    return Box((min(a[0], b[0]), min(a[1], b[1]), min(a[2], b[2])), (max(a[0], b[0]), max(a[1], b[1]), max(a[2], b[2])))
