"""Features of a workpiece, as drawings state them: points, distances, diameters, positions of holes and flatness.

Every feature is reduced to points of the workpiece and to a matrix that takes the displacements of these points to a
few numbers, since each error is linear in the displacements as long as they are small against the feature. `Measure`
says how the numbers become the error that a drawing limits.

Coordinates are those of the workpiece, in mm.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import ArrayLike

from twin.arrays import Array, as_vector
from twin.errors import DataError

_AROUND = 12  # points around a bore; the error field has no waves that are short against a bore
_ACROSS = 9  # points along each side of a face: with 5, a flatness came out a fifth too small
_PARALLEL = 0.9  # of the cosine between the direction of a face and the axis from which its sides are derived


class FeatureKind(StrEnum):
    """Kind of a feature; the values are the words of a feature file."""

    POINT = "point"
    DISTANCE = "distance"
    DIAMETER = "diameter"
    POSITION = "position"
    FLATNESS = "flatness"
    DATUM = "datum"
    ACCEPTANCE_TEST = "acceptance test"


class Measure(StrEnum):
    """Way in which the numbers of a feature become its error.

    `SIGNED`: the one number is the error. `ZONE`: twice the length of the vector of the numbers, the diameter of the
    smallest zone around the nominal place that contains the feature (ISO 1101, position). `RANGE`: largest minus
    smallest number (ISO 1101, flatness).
    """

    SIGNED = "signed"
    ZONE = "zone"
    RANGE = "range"


@dataclass(frozen=True)
class Tolerance:
    """Limits of the error of a feature in mm. A limit that is not set is None.

    Raises DataError if no limit is set, or if the lower one is not below the upper one.
    """

    lower_mm: float | None = None
    upper_mm: float | None = None

    def __post_init__(self) -> None:
        if self.lower_mm is None and self.upper_mm is None:
            raise DataError("a tolerance needs a lower or an upper limit")
        if self.lower_mm is not None and self.upper_mm is not None and not self.lower_mm < self.upper_mm:
            raise DataError("the lower limit of a tolerance must be below the upper one", hint="Exchange the limits")

    @property
    def half_width_mm(self) -> float:
        """Half of the range between the limits, or the distance from 0 of the one limit that is set."""
        limits = [limit for limit in (self.lower_mm, self.upper_mm) if limit is not None]
        return abs(limits[0]) if len(limits) == 1 else 0.5 * (limits[1] - limits[0])


@dataclass(frozen=True, eq=False)
class Feature:
    """Feature of a workpiece.

    `points` (n, 3) are the points of the workpiece, in mm, whose displacements make up its error. `matrix` (k, 3n)
    takes the displacements, ordered point by point with x, y and z of each, to k numbers, and `measure` takes these to
    the error. `depends_on_datum` is True if the error depends on how the coordinate system of the workpiece was set.
    """

    name: str
    kind: FeatureKind
    points: Array
    matrix: Array
    measure: Measure
    depends_on_datum: bool
    tolerance: Tolerance | None = None


def point(name: str, at: ArrayLike, direction: ArrayLike, tolerance: Tolerance | None = None) -> Feature:
    """Return the feature of a point `at` (3,) of a surface with the normal `direction` (3,): the displacement along the
    normal. A positive error lies on the side to which the normal points."""
    matrix = _unit(direction, name)[None, :]
    return Feature(name, FeatureKind.POINT, as_vector(at, 3, name)[None, :], matrix, Measure.SIGNED, True, tolerance)


def distance(name: str, first: ArrayLike, second: ArrayLike, tolerance: Tolerance | None = None) -> Feature:
    """Return the distance between two points (3,). A positive error means a distance that is too long."""
    points = np.stack((as_vector(first, 3, name), as_vector(second, 3, name)))
    between = _unit(points[1] - points[0], name, "the two points of a distance coincide")
    matrix = np.concatenate((-between, between))[None, :]
    return Feature(name, FeatureKind.DISTANCE, points, matrix, Measure.SIGNED, False, tolerance)


def diameter(
    name: str, centre: ArrayLike, axis: ArrayLike, size_mm: float, tolerance: Tolerance | None = None
) -> Feature:
    """Return the diameter of a bore or boss of the nominal diameter `size_mm` that is milled on a circle around
    `centre` (3,), normal to `axis` (3,). The error is that of the least-squares circle (ISO 12181)."""
    radial = _circle(axis, name)
    points = as_vector(centre, 3, name) + 0.5 * _size(size_mm, name) * radial
    # the least-squares circle through evenly spaced points has the mean radius
    matrix = (2.0 / len(radial)) * radial.reshape(1, -1)
    return Feature(name, FeatureKind.DIAMETER, points, matrix, Measure.SIGNED, False, tolerance)


def position(name: str, centre: ArrayLike, axis: ArrayLike, tolerance: Tolerance | None = None) -> Feature:
    """Return the position (ISO 1101) of a hole at `centre` (3,) with the direction `axis` (3,). The error is the
    diameter of the zone around the nominal axis in which the true centre lies."""
    across = _across(_unit(axis, name))
    at = as_vector(centre, 3, name)[None, :]
    return Feature(name, FeatureKind.POSITION, at, across, Measure.ZONE, True, _zone(tolerance, name))


def flatness(
    name: str, centre: ArrayLike, normal: ArrayLike, sides_mm: tuple[float, float], tolerance: Tolerance | None = None
) -> Feature:
    """Return the flatness of a rectangular face around `centre` (3,), from the least-squares plane (ISO 12781).

    The first side lies along X, or along Y if `normal` (3,) points along X; the second one is perpendicular to it.
    """
    upwards = _unit(normal, name)
    along, beside = _face_directions(upwards)
    shares = np.linspace(-0.5, 0.5, _ACROSS)
    u, v = (one.reshape(-1) for one in np.meshgrid(*(_size(side, name) * shares for side in sides_mm), indexing="ij"))
    points = as_vector(centre, 3, name) + u[:, None] * along + v[:, None] * beside
    planes = np.linalg.qr(np.stack((np.ones_like(u), u, v), axis=1))[0]
    residual = np.eye(len(u)) - planes @ planes.T
    matrix = np.einsum("kn,c->knc", residual, upwards).reshape(len(u), -1)
    return Feature(name, FeatureKind.FLATNESS, points, matrix, Measure.RANGE, False, _zone(tolerance, name))


def datum(name: str, at: ArrayLike) -> Feature:
    """Return a point `at` (3,) to which the coordinate system of the workpiece is fitted."""
    return Feature(name, FeatureKind.DATUM, as_vector(at, 3, name)[None, :], np.eye(3), Measure.ZONE, True)


def _circle(axis: ArrayLike, name: str) -> Array:
    """Return unit vectors (n, 3) evenly spaced around `axis`."""
    across = _across(_unit(axis, name))
    angles = 2.0 * np.pi * np.arange(_AROUND) / _AROUND
    return np.asarray(np.stack((np.cos(angles), np.sin(angles)), axis=1) @ across)


def _across(direction: Array) -> Array:
    """Return two unit vectors (2, 3) perpendicular to each other and to the unit vector `direction`."""
    return np.stack(_face_directions(direction))


def _face_directions(normal: Array) -> tuple[Array, Array]:
    first = np.array([1.0, 0.0, 0.0]) if abs(normal[0]) < _PARALLEL else np.array([0.0, 1.0, 0.0])
    along = first - (first @ normal) * normal
    along /= np.linalg.norm(along)
    return along, np.cross(normal, along)


def _zone(tolerance: Tolerance | None, name: str) -> Tolerance | None:
    """Return the tolerance of an error that cannot be negative."""
    if tolerance is not None and not (tolerance.lower_mm is None and (tolerance.upper_mm or 0.0) > 0.0):
        raise DataError(f"{name}: a position or a flatness has one limit, an upper one above 0")
    return tolerance


def _unit(direction: ArrayLike, name: str, message: str = "a direction needs a component that is not 0") -> Array:
    given = as_vector(direction, 3, name)
    length = float(np.linalg.norm(given))
    if length == 0.0:
        raise DataError(f"{name}: {message}")
    return given / length


def _size(size_mm: float, name: str) -> float:
    if not (np.isfinite(size_mm) and size_mm > 0.0):
        raise DataError(f"{name}: a size must be a positive number of mm, not {size_mm:g}")
    return float(size_mm)
