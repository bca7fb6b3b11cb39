"""Where on a ball it is touched, and how well its centre is known from that."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from twin.errors import DataError
from twin.sphere import fit_sphere

Vectors = NDArray[np.float64]

# Rings of touches beside the pole: (latitude above the equator in degrees, touches, turn about the stylus).
# The five-point ring is turned by 45° so that a holder that stands along a machine axis is passed by.
RINGS: dict[int, tuple[tuple[float, int, float], ...]] = {
    5: ((0.0, 4, 45.0),),
    9: ((45.0, 4, 0.0), (0.0, 4, 45.0)),
    13: ((60.0, 4, 0.0), (30.0, 4, 45.0), (0.0, 4, 0.0)),
    25: ((60.0, 8, 0.0), (30.0, 8, 22.5), (0.0, 8, 0.0)),
}


def approach_directions(count: int, stylus_axis: Vectors) -> Vectors:
    """Approach vectors of the pattern with `count` touches, the pole first.

    `stylus_axis` (3,): unit vector from the ram towards the tip. Shape (count, 3).
    DataError for a pattern that is not one of 5, 9, 13, 25.
    """
    if count not in RINGS:
        raise DataError(f"no pattern of {count} touches", hint=f"there are {sorted(RINGS)}")
    pole = stylus_axis / np.linalg.norm(stylus_axis)
    first, second = _perpendiculars(pole)
    rows = [pole]
    for latitude_deg, touches, turn_deg in RINGS[count]:
        height, width = math.sin(math.radians(latitude_deg)), math.cos(math.radians(latitude_deg))
        for index in range(touches):
            angle = math.radians(turn_deg + 360.0 * index / touches)
            sideways = math.cos(angle) * first + math.sin(angle) * second
            rows.append(height * pole - width * sideways)
    return np.array(rows)


def centre_covariance(directions: Vectors, touch_sigma_mm: float) -> Vectors:
    """Covariance (3, 3) mm² of a ball centre touched along `directions` (k, 3), the radius being estimated as well."""
    return fit_sphere(-directions, touch_sigma_mm).centre_covariance


def _perpendiculars(pole: Vectors) -> tuple[Vectors, Vectors]:
    """Two unit vectors square to the pole, along machine axes where the pole is one."""
    axis = np.eye(3)[np.argmin(np.abs(pole))]
    first = axis - pole * (axis @ pole)
    first /= np.linalg.norm(first)
    return first, np.cross(first, pole)
