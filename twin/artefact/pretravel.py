"""Pretravel of a touch-trigger probe by direction: low-order harmonics about the stylus, from one densely touched ball.

A probe on three seats trips later in some directions than in others (lobing). What all directions have in common acts
as a smaller stylus radius, what is a first harmonic acts as a displaced stylus centre; neither can be told from the
ball, both are common to all balls. The map holds what is left: it refers every touch to the sphere that was fitted
through the whole qualification.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from twin.arrays import Array
from twin.artefact.touch_pattern import perpendiculars
from twin.errors import DataError

HIGHEST_ORDER = 3
"""Waves about the stylus: three seats give three lobes; rings of eight carry no more."""


@dataclass(frozen=True, eq=False)
class PretravelMap:
    """`coefficients_mm` of centre (3), radius (1) and the harmonics, about the stylus axis `stylus_axis` (3,).

    `noise_mm`: rms of what the harmonics left of the residuals, per degree of freedom; it is touch noise where the
    harmonics suffice. `largest_mm`: peak of the map over the touches it was made from.
    """

    stylus_axis: Array
    coefficients_mm: Array
    noise_mm: float
    largest_mm: float

    def offsets_mm(self, directions: Array) -> Array:
        """(k,) for approach directions (k, 3): by how much farther out than the sphere a touch latches."""
        return np.asarray(_terms(directions, self.stylus_axis) @ self.coefficients_mm)

    def corrected(self, points: Array, directions: Array) -> Array:
        """Latched points (k, 3) brought to where a probe without lobing would have latched."""
        return np.asarray(points + self.offsets_mm(directions)[:, None] * directions)


def fit_pretravel(directions: Array, residuals_mm: Array, stylus_axis: Array) -> PretravelMap:
    """Harmonics through the residuals (k,) of a sphere fitted with free radius to touches along `directions` (k, 3).

    The harmonics are made square to centre and radius over these touches, so that the sphere stays the one that was
    fitted. DataError where the touches are too few or lie on too few rings.
    """
    terms = _terms(directions, stylus_axis)
    touches, unknowns = terms.shape
    sphere, harmonics = terms[:, :4], terms[:, 4:]
    absorbed = np.linalg.lstsq(sphere, harmonics, rcond=None)[0]
    square = harmonics - sphere @ absorbed
    if touches <= unknowns or np.linalg.matrix_rank(square) < square.shape[1]:
        raise DataError(
            f"{touches} touches do not carry a pretravel map of {square.shape[1]} harmonics",
            hint="qualify with three rings of eight and the pole",
        )
    found = np.linalg.lstsq(square, residuals_mm, rcond=None)[0]
    left = residuals_mm - square @ found
    return PretravelMap(
        stylus_axis=stylus_axis,
        coefficients_mm=np.concatenate((-absorbed @ found, found)),
        noise_mm=float(np.sqrt(left @ left / (touches - unknowns))),
        largest_mm=float(np.abs(square @ found).max()),
    )


def _terms(directions: Array, stylus_axis: Array) -> Array:
    """(k, 18): outward normal, 1, and for each order 0 … 3 the two lowest harmonics that no centre and no radius holds.

    With h the height towards the ram, w the distance from the stylus axis and a the angle about it: wᵐ cos(ma) and
    wᵐ sin(ma) times two powers of h.
    """
    first, second = perpendiculars(stylus_axis)
    normals = -directions
    height, x, y = normals @ -stylus_axis, normals @ first, normals @ second
    width, angle = np.hypot(x, y), np.arctan2(y, x)
    columns = [*normals.T, np.ones_like(height), height**2, height**3]
    for order in range(1, HIGHEST_ORDER + 1):
        lowest = 1 if order == 1 else 0
        for power in (lowest, lowest + 1):
            shape = width**order * height**power
            columns += [shape * np.cos(order * angle), shape * np.sin(order * angle)]
    return np.column_stack(columns)


def direction_at(stylus_axis: Array, latitude_rad: float, angle_rad: float) -> Array:
    """(3,) approach direction of a touch at a latitude above the equator (the ram's side) and an angle about it."""
    first, second = perpendiculars(stylus_axis)
    sideways = math.cos(angle_rad) * first + math.sin(angle_rad) * second
    return np.asarray(math.sin(latitude_rad) * stylus_axis - math.cos(latitude_rad) * sideways)
