"""Touch patterns on a ball, and the uncertainty of the ball centre that results from each pattern."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from twin.arrays import Array
from twin.artefact.sphere_fit import fit_sphere
from twin.errors import DataError

Ring = tuple[float, int, float]
"""Touches on one circle of latitude: latitude above the equator in degrees, number of touches, rotation about the
stylus axis in degrees.
"""

# A touch on the equator within 30° of the holder would hit it. Touching the equator only at 45° avoids a holder along
# a machine axis or in one plane with the stylus. Most touches are therefore at latitude 45° and above, which nothing
# obstructs if the pole of the ball is free.
# Three touches at right angles to each other give all three coordinates of the centre the variance of a touch. The
# radius must be known then.
RINGS: dict[int, tuple[Ring, ...]] = {
    3: ((0.0, 1, 45.0), (0.0, 1, 135.0)),
    5: ((0.0, 4, 45.0),),
    9: ((45.0, 4, 0.0), (0.0, 4, 45.0)),
    13: ((45.0, 8, 0.0), (0.0, 4, 45.0)),
    25: ((67.5, 8, 0.0), (45.0, 12, 15.0), (0.0, 4, 45.0)),
}

RADIUS_PATTERN = 5
"""Number of touches of the smallest pattern that determines the radius of the ball, too."""

QUALIFYING_RINGS: tuple[Ring, ...] = ((60.0, 8, 0.0), (30.0, 8, 22.5), (0.0, 8, 0.0))
"""Rings of touches for the qualification of a stylus on a free-standing ball.

Rings of eight touches distinguish lobed pretravel from a shift of the centre. Rings of four do not, because on four
points the third harmonic looks like the first.
"""

LOCATING_RINGS: tuple[Ring, ...] = ((45.0, 4, 45.0),)
"""Ring for locating a ball that may be displaced by some mm.

The touches are well above the equator, because the holder begins near it.
"""

_NEGLIGIBLE = 1e-6


def approach_directions(count: int, stylus_axis: Array) -> Array:
    """Return the approach directions of the touch pattern with `count` touches on a ball as unit vectors, in an array
    (count, 3). The first touch is at the pole, which is the point of the ball that faces the stylus.

    `stylus_axis` (3,) is the unit vector from the ram towards the tip. Raises DataError if there is no pattern of
    `count` touches.
    """
    if count not in RINGS:
        raise DataError(f"no pattern of {count} touches", hint=f"available patterns: {sorted(RINGS)}")
    return ring_directions(RINGS[count], stylus_axis)


def ring_directions(rings: Sequence[Ring], stylus_axis: Array) -> Array:
    """Return the approach directions of one touch at the pole of a ball (the point that faces the stylus) and of all
    touches on `rings`, as unit vectors. A ring is a circle of latitude of the ball.

    The array has one row (3,) per touch. The touch at the pole is first, followed by the rings in the given order.
    """
    pole = stylus_axis / np.linalg.norm(stylus_axis)
    first, second = perpendiculars(pole)
    rows = [pole]
    for latitude_deg, touches, turn_deg in rings:
        height, width = math.sin(math.radians(latitude_deg)), math.cos(math.radians(latitude_deg))
        for index in range(touches):
            angle = math.radians(turn_deg + 360.0 * index / touches)
            sideways = math.cos(angle) * first + math.sin(angle) * second
            rows.append(height * pole - width * sideways)
    return np.array(rows)


def determines_radius(directions: Array) -> bool:
    """Return True if touches along `directions` (k, 3) determine the radius of the ball together with its centre; three
    touches need a known radius."""
    return len(directions) >= RADIUS_PATTERN


def centre_covariance(directions: Array, touch_sigma_mm: float) -> Array:
    """Return the covariance (3, 3) of a fitted ball centre in mm² if the radius is estimated together with the centre.

    The ball is touched k times along `directions` (k, 3). Each touch has the standard uncertainty `touch_sigma_mm`.
    """
    return fit_sphere(-directions, touch_sigma_mm).centre_covariance


def known_radius_covariance(directions: Array, touch_sigma_mm: float, radius_sigma_mm: float) -> Array:
    """Return the covariance (3, 3) of a fitted ball centre in mm² if the radius is known and is not estimated.

    The ball is touched k times along `directions` (k, 3). Each touch has the standard uncertainty `touch_sigma_mm`. The
    known radius has the standard uncertainty `radius_sigma_mm`. An error of the radius shifts the centre, so it
    contributes to the covariance.
    """
    # A unit sphere serves as well as the ball: the covariance depends on the directions and the noise, not on the
    # radius.
    given = fit_sphere(-directions, touch_sigma_mm, 1.0, near=np.zeros(3)).centre_covariance
    moved = centre_shift_per_radius(directions)
    return given + radius_sigma_mm**2 * np.outer(moved, moved)


def centre_shift_per_radius(directions: Array) -> Array:
    """Return the derivative (3,) of a fitted ball centre with respect to the assumed radius, in mm per mm.

    If a sphere is fitted with a fixed radius that is too large by ε, the fitted centre is shifted by this derivative
    times ε. The ball is touched k times along the unit vectors `directions` (k, 3), which point towards the ball. The
    shift δ is the least-squares solution of the k equations d·δ = ε, with one equation for each direction d.
    """
    # A radius too large by ε pushes every fitted surface point outwards by ε; the centre yields along the touches, d·δ
    # = ε.
    return np.asarray(np.linalg.lstsq(directions, np.ones(len(directions)), rcond=None)[0])


def redundancies(directions: Array) -> Array:
    """Return the redundancy number of each of k touches of a ball along `directions` (k, 3). It is the share, from 0 to
    1, of an error of the touch that appears in the residual of the same touch.

    The redundancy number is that of Baarda for a sphere fit with free radius. It is 1 minus the touch's diagonal
    element of the hat matrix. If the redundancy number is 0, an error of the touch cannot be detected, because no other
    touch checks it. An example is the touch at the pole in the five-touch pattern.
    """
    # Q Qᵀ of the QR decomposition is the hat matrix J (JᵀJ)⁻¹Jᵀ.
    jacobian = np.column_stack([-directions, np.ones(len(directions))])
    basis = np.linalg.qr(jacobian)[0]
    left = 1.0 - np.einsum("ij,ij->i", basis, basis)
    return np.asarray(np.where(left > _NEGLIGIBLE, left, 0.0))


def perpendiculars(pole: Array) -> tuple[Array, Array]:
    """Return two unit vectors that are perpendicular to `pole` and to each other. If `pole` is parallel to a machine
    axis, both vectors are also parallel to machine axes.
    """
    # the machine axis farthest from the pole, made perpendicular to it (Gram-Schmidt)
    axis = np.eye(3)[np.argmin(np.abs(pole))]
    first = axis - pole * (axis @ pole)
    first /= np.linalg.norm(first)
    return first, np.cross(first, pole)
