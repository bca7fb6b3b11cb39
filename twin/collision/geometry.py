"""Capsules and boxes: the distance between two bodies, and the first contact if one of them moves in a straight line.

Points are (x, y, z) in mm. The distance between two convex bodies is a convex function of the translation of one body.
A tangent to this function is therefore never above the function. A step to the zero of the tangent never goes beyond
the first contact, and repeated steps converge to the contact quadratically. For this reason the function
`swept_contact`, which finds the first contact, is exact and needs few evaluations.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from twin.errors import DataError

Point = tuple[float, float, float]
Separation = tuple[float, Point]
"""Distance between two surfaces in mm (negative inside) and the unit vector from the second body to the first."""

_Axes = tuple[float, float, float, float, float, float, float, float, float, float]
"""Components of two segments u and v, the products u·u, v·v, u·v, and (u·u)(v·v) - (u·v)², which is 0 if u and v are
parallel.
"""

CONTACT_TOLERANCE_MM = 1e-6
# a guard: the steps converge quadratically
_MAX_TANGENTS = 60
_TINY = 1e-12
_ORIGIN: Point = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Capsule:
    """Set of all points within `radius` of the line segment from `a` to `b`. It is a sphere if `a` equals `b`."""

    a: Point
    b: Point
    radius: float

    def __post_init__(self) -> None:
        # a sum is finite only if all its terms are; cheap, because every body of every pose is checked
        if not (self.radius >= 0.0 and math.isfinite(sum(self.a) + sum(self.b))):
            raise DataError(f"a capsule needs finite ends and a radius of at least 0, got {self}")

    @property
    def lower(self) -> Point:
        (ax, ay, az), (bx, by, bz), r = self.a, self.b, self.radius
        return (ax if ax < bx else bx) - r, (ay if ay < by else by) - r, (az if az < bz else bz) - r

    @property
    def upper(self) -> Point:
        (ax, ay, az), (bx, by, bz), r = self.a, self.b, self.radius
        return (ax if ax > bx else bx) + r, (ay if ay > by else by) + r, (az if az > bz else bz) + r

    def translated(self, by: Point) -> Capsule:
        return Capsule(translate_point(self.a, by), translate_point(self.b, by), self.radius)


@dataclass(frozen=True)
class Box:
    """Box with faces perpendicular to the coordinate axes, from the corner `lower` to the corner `upper`."""

    lower: Point
    upper: Point

    def __post_init__(self) -> None:
        if not all(low <= high for low, high in zip(self.lower, self.upper, strict=True)):
            raise DataError(f"a box needs lower <= upper on every axis, got {self}")

    def translated(self, by: Point) -> Box:
        return Box(translate_point(self.lower, by), translate_point(self.upper, by))


Shape = Capsule | Box


def sphere(centre: Point, radius: float) -> Capsule:
    return Capsule(centre, centre, radius)


def point(values: Iterable[float]) -> Point:
    """Convert an array, a list or a generator with three numbers to a tuple of three plain floats."""
    x, y, z = values.tolist() if isinstance(values, np.ndarray) else values
    return float(x), float(y), float(z)


def translate_point(p: Point, q: Point) -> Point:
    return p[0] + q[0], p[1] + q[1], p[2] + q[2]


def separation(first: Shape, second: Shape) -> Separation:
    """Return the distance between the surfaces of two bodies in mm, and the unit vector from the second body to the
    first. The distance is negative if the bodies overlap.
    """
    return _separation_at(first, _ORIGIN, second)


def swept_contact(
    moving: Shape, obstacle: Shape, displacement: Point, clearance_mm: float = 0.0, start: Point = _ORIGIN
) -> float | None:
    """Return the fraction (0 to 1) of `displacement` at which two bodies come within `clearance_mm`. Return None if
    they do not.

    The body `moving` is first translated by `start`. If the bodies are already within the clearance there, this counts
    as a contact only if the motion brings them closer.
    """
    if isinstance(moving, Capsule) and isinstance(obstacle, Capsule):
        return _swept_capsules(moving, obstacle, displacement, clearance_mm, start)
    fraction = 0.0
    for _ in range(_MAX_TANGENTS):
        here = (
            start[0] + displacement[0] * fraction,
            start[1] + displacement[1] * fraction,
            start[2] + displacement[2] * fraction,
        )
        distance, (nx, ny, nz) = _separation_at(moving, here, obstacle)
        # Newton step on the distance along the motion: fraction -= (distance - clearance) / (normal · displacement)
        slope = nx * displacement[0] + ny * displacement[1] + nz * displacement[2]
        # The distance is convex along the motion: once it no longer falls, it never will. A NaN slope (bodies that
        # coincide) is not ≥ 0 and counts as a contact.
        if slope >= 0.0:
            return None
        gap = distance - clearance_mm
        if gap <= CONTACT_TOLERANCE_MM:
            return fraction
        fraction -= gap / slope
        if fraction > 1.0:
            return None
    return fraction


def _swept_capsules(
    moving: Capsule, obstacle: Capsule, displacement: Point, clearance_mm: float, start: Point
) -> float | None:
    """Compute `swept_contact` for two capsules by the same tangent steps.

    Quantities that a translation does not change are computed only once.
    """
    reach = moving.radius + obstacle.radius + clearance_mm
    axes = _axes(moving, obstacle)
    (ax, ay, az), (bx, by, bz), (wx, wy, wz) = moving.a, obstacle.a, displacement
    rx, ry, rz = ax + start[0] - bx, ay + start[1] - by, az + start[2] - bz
    fraction = 0.0
    for _ in range(_MAX_TANGENTS):
        x, y, z = _gap_of_axes(axes, rx + wx * fraction, ry + wy * fraction, rz + wz * fraction)
        distance = math.sqrt(x * x + y * y + z * z)
        if distance < _TINY:
            return fraction
        slope = (x * wx + y * wy + z * wz) / distance
        if slope >= 0.0:
            return None
        gap = distance - reach
        if gap <= CONTACT_TOLERANCE_MM:
            return fraction
        fraction -= gap / slope
        if fraction > 1.0:
            return None
    return fraction


def _separation_at(first: Shape, by: Point, second: Shape) -> Separation:
    """Compute `separation` with the first body translated by `by`, without creating a body (called very often)."""
    if isinstance(first, Capsule):
        a, b = translate_point(first.a, by), translate_point(first.b, by)
        if isinstance(second, Capsule):
            (ax, ay, az), (cx, cy, cz) = a, second.a
            distance, normal = _direction(_ORIGIN, _gap_of_axes(_axes(first, second), ax - cx, ay - cy, az - cz))
            return distance - first.radius - second.radius, normal
        return _capsule_from_box(a, b, first.radius, second.lower, second.upper)
    lower, upper = translate_point(first.lower, by), translate_point(first.upper, by)
    if isinstance(second, Capsule):
        distance, (x, y, z) = _capsule_from_box(second.a, second.b, second.radius, lower, upper)
        return distance, (-x, -y, -z)
    return _between_boxes(lower, upper, second)


def _axes(first: Capsule, second: Capsule) -> _Axes:
    (ax, ay, az), (bx, by, bz) = first.a, first.b
    ux, uy, uz = bx - ax, by - ay, bz - az
    (ax, ay, az), (bx, by, bz) = second.a, second.b
    vx, vy, vz = bx - ax, by - ay, bz - az
    uu, vv, uv = ux * ux + uy * uy + uz * uz, vx * vx + vy * vy + vz * vz, ux * vx + uy * vy + uz * vz
    determinant = uu * vv - uv * uv
    # A determinant within rounding of zero means parallel axes; dividing by it would give an arbitrary point.
    return ux, uy, uz, vx, vy, vz, uu, vv, uv, determinant if determinant > _TINY * uu * vv else 0.0


def _gap_of_axes(axes: _Axes, x: float, y: float, z: float) -> Point:
    """Return the vector from the second axis to the first at their closest points.

    (x, y, z) is the vector from the start of the second axis to the start of the first. The algorithm is that of
    Ericson, Real-Time Collision Detection, 5.1.9. It uses plain floats and is ten times as fast as with arrays of three
    numbers.
    """
    ux, uy, uz, vx, vy, vz, uu, vv, uv, determinant = axes
    along_u, along_v = ux * x + uy * y + uz * z, vx * x + vy * y + vz * z
    # Closest points of the infinite lines, then clamped one after the other: s to its segment, t for this s, and s
    # again for the clamped t.
    s = t = 0.0
    if determinant:
        s = (uv * along_v - along_u * vv) / determinant
        s = 0.0 if s < 0.0 else 1.0 if s > 1.0 else s
    if vv > _TINY:
        t = (uv * s + along_v) / vv
        t = 0.0 if t < 0.0 else 1.0 if t > 1.0 else t
    if uu > _TINY:
        s = (uv * t - along_u) / uu
        s = 0.0 if s < 0.0 else 1.0 if s > 1.0 else s
    return x + s * ux - t * vx, y + s * uy - t * vy, z + s * uz - t * vz


def _capsule_from_box(a: Point, b: Point, radius: float, lower: Point, upper: Point) -> Separation:
    near = _closest_on_segment_to_box(a, b, lower, upper)
    distance, normal = _direction(_clamped_into(near, lower, upper), near)
    return distance - radius, normal


def _closest_on_segment_to_box(a: Point, b: Point, lower: Point, upper: Point) -> Point:
    """Return the point of the segment closest to the box.

    The squared distance is convex along the segment. Its slope is piecewise linear, with kinks at the planes of the
    faces, and the minimum is at the root of the slope.
    """
    d = (b[0] - a[0], b[1] - a[1], b[2] - a[2])
    kinks = [0.0, 1.0]
    for start, step, low, high in zip(a, d, lower, upper, strict=True):
        if abs(step) > _TINY:
            kinks += [s for s in ((low - start) / step, (high - start) / step) if 0.0 < s < 1.0]
    kinks.sort()
    previous, slope_before = 0.0, _slope_to_box(a, d, 0.0, lower, upper)
    if slope_before >= 0.0:
        return a
    for kink in kinks[1:]:
        slope = _slope_to_box(a, d, kink, lower, upper)
        if slope >= 0.0:
            # the slope is linear between two kinks: interpolate to its root
            s = previous - slope_before * (kink - previous) / (slope - slope_before)
            return a[0] + s * d[0], a[1] + s * d[1], a[2] + s * d[2]
        previous, slope_before = kink, slope
    return b


def _slope_to_box(a: Point, d: Point, s: float, lower: Point, upper: Point) -> float:
    """Return half the derivative with respect to s of the squared distance of a + s·d from the box.

    It is linear in s between two planes of faces.
    """
    here = (a[0] + s * d[0], a[1] + s * d[1], a[2] + s * d[2])
    inside = _clamped_into(here, lower, upper)
    return sum((p - q) * step for p, q, step in zip(here, inside, d, strict=True))


def _between_boxes(lower: Point, upper: Point, second: Box) -> Separation:
    # the gap between the boxes along each axis, 0 if they overlap there; the distance is the length of this vector
    gap = [
        fl - su if fl > su else fu - sl if fu < sl else 0.0
        for fl, fu, sl, su in zip(lower, upper, second.lower, second.upper, strict=True)
    ]
    return _direction((0.0, 0.0, 0.0), (gap[0], gap[1], gap[2]))


def _direction(origin: Point, target: Point) -> Separation:
    """Return distance and unit vector from `origin` to `target`.

    If they coincide, the vector is NaN, so that no motion is considered to lead away.
    """
    x, y, z = target[0] - origin[0], target[1] - origin[1], target[2] - origin[2]
    distance = math.sqrt(x * x + y * y + z * z)
    if distance < _TINY:
        return 0.0, (math.nan, math.nan, math.nan)
    return distance, (x / distance, y / distance, z / distance)


def _clamped_into(p: Point, lower: Point, upper: Point) -> Point:
    return (
        min(max(p[0], lower[0]), upper[0]),
        min(max(p[1], lower[1]), upper[1]),
        min(max(p[2], lower[2]), upper[2]),
    )
