"""Where on a ball it is touched, and how well its centre is known from that."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from twin.arrays import Array
from twin.artefact.sphere_fit import fit_sphere
from twin.errors import DataError

Ring = tuple[float, int, float]
"""Touches beside the pole: (latitude above the equator in degrees, touches, turn about the stylus in degrees)."""

# A holder that stands along a machine axis, or leans in a plane with the stylus, is passed by where the equator is
# touched at 45° only: a touch of the equator within 30° of the holder runs into it. Hence few touches there, and the
# many at 45° and above, where nothing is in the way of a ball whose pole is free.
RINGS: dict[int, tuple[Ring, ...]] = {
    5: ((0.0, 4, 45.0),),
    9: ((45.0, 4, 0.0), (0.0, 4, 45.0)),
    13: ((45.0, 8, 0.0), (0.0, 4, 45.0)),
    25: ((67.5, 8, 0.0), (45.0, 12, 15.0), (0.0, 4, 45.0)),
}

QUALIFYING_RINGS: tuple[Ring, ...] = ((60.0, 8, 0.0), (30.0, 8, 22.5), (0.0, 8, 0.0))
"""The stylus is qualified on one ball that stands free: rings of eight tell a lobed pretravel from a shift of the
centre, which rings of four cannot (the third harmonic looks like the first on four points)."""

LOCATING_RINGS: tuple[Ring, ...] = ((45.0, 4, 45.0),)
"""To see where a ball is that may stand some mm off: well before its equator, where the holder begins."""

_AS_GOOD_AS_NOTHING = 1e-6


def approach_directions(count: int, stylus_axis: Array) -> Array:
    """Approach vectors of the pattern with `count` touches, the pole first.

    `stylus_axis` (3,): unit vector from the ram towards the tip. Shape (count, 3).
    DataError for a pattern that is not one of 5, 9, 13, 25.
    """
    if count not in RINGS:
        raise DataError(f"no pattern of {count} touches", hint=f"there are {sorted(RINGS)}")
    return ring_directions(RINGS[count], stylus_axis)


def ring_directions(rings: Sequence[Ring], stylus_axis: Array) -> Array:
    """Approach vectors (1 + touches of all rings, 3): the pole, then ring by ring."""
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


def centre_covariance(directions: Array, touch_sigma_mm: float) -> Array:
    """Covariance (3, 3) mm² of a ball centre touched along `directions` (k, 3), the radius being estimated as well."""
    return fit_sphere(-directions, touch_sigma_mm).centre_covariance


def known_radius_covariance(directions: Array, touch_sigma_mm: float, radius_sigma_mm: float) -> Array:
    """The same (3, 3) mm² with a radius known to `radius_sigma_mm`: part of its error goes into the centre."""
    given = fit_sphere(-directions, touch_sigma_mm, 1.0, near=np.zeros(3)).centre_covariance
    moved = centre_shift_per_radius(directions)
    return given + radius_sigma_mm**2 * np.outer(moved, moved)


def centre_shift_per_radius(directions: Array) -> Array:
    """(3,): by how much the centre moves for each mm that a known radius is too large.

    The least squares of u·δc = -δr over the outward normals u = -direction.
    """
    return np.asarray(np.linalg.lstsq(directions, np.ones(len(directions)), rcond=None)[0])


def redundancies(directions: Array) -> Array:
    """(k,) in 0 … 1: the part of a touch's own error that its residual shows, the radius being free.

    1 - hᵢ, h the diagonal of the hat matrix (Baarda's redundancy numbers). 0: nothing checks this touch, as the pole of
    the five-point pattern.
    """
    jacobian = np.column_stack([-directions, np.ones(len(directions))])
    basis = np.linalg.qr(jacobian)[0]
    left = 1.0 - np.einsum("ij,ij->i", basis, basis)
    return np.asarray(np.where(left > _AS_GOOD_AS_NOTHING, left, 0.0))


def perpendiculars(pole: Array) -> tuple[Array, Array]:
    """Two unit vectors square to the pole, along machine axes where the pole is one."""
    axis = np.eye(3)[np.argmin(np.abs(pole))]
    first = axis - pole * (axis @ pole)
    first /= np.linalg.norm(first)
    return first, np.cross(first, pole)
