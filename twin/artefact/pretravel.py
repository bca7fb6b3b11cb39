"""Direction-dependent pretravel of a touch-trigger probe, represented by harmonics about the stylus axis.

The harmonics are fitted to one ball with many touches. A probe whose stylus rests on three seats triggers later in some
directions than in others (lobing). The mean pretravel over all directions is equivalent to a smaller stylus radius, and
the first harmonic is equivalent to a displaced stylus centre. Touches of a ball cannot distinguish these two effects
from an error of the radius and of the centre, and both effects are the same on all balls. The pretravel map of this
module therefore contains only the higher harmonics. It moves every touch onto the sphere that is fitted to all touches
of the qualification ball.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from twin.arrays import Array
from twin.artefact.touch_pattern import perpendiculars
from twin.errors import DataError

HIGHEST_ORDER = 3
"""Highest harmonic about the stylus axis; three seats give three lobes, and rings of eight touches resolve no more."""


@dataclass(frozen=True, eq=False)
class PretravelMap:
    """Pretravel of a probe as a function of the approach direction.

    - `coefficients_mm` (18,) contains the coefficients of the centre (3), of the radius (1) and of the harmonics (14).
    - `stylus_axis` (3,) is the unit vector from the ram towards the tip.
    - `noise_mm` is the rms residual of the fit of the map to touches of one ball, corrected for the degrees of freedom.
      If the harmonics describe the direction-dependent pretravel (lobing) completely, `noise_mm` is the touch noise.
    - `largest_mm` is the largest absolute value of the map at the fitted touches.
    """

    stylus_axis: Array
    coefficients_mm: Array
    noise_mm: float
    largest_mm: float

    def offsets_mm(self, directions: Array) -> Array:
        """Return for each of k approach directions (k, 3) the distance in mm from the sphere fitted to the
        qualification touches at which the probe triggers. The distance is positive if the latched point is outside this
        sphere.
        """
        return np.asarray(_terms(directions, self.stylus_axis) @ self.coefficients_mm)

    def correct(self, points: Array, directions: Array) -> Array:
        """Correct the latched points (k, 3) in mm of touches along `directions` (k, 3) for lobing. The result is the
        points that a probe without lobing would latch.
        """
        return np.asarray(points + self.offsets_mm(directions)[:, None] * directions)


def fit_pretravel(directions: Array, residuals_mm: Array, stylus_axis: Array) -> PretravelMap:
    """Fit a pretravel map to the residuals of k touches of one ball along `directions` (k, 3). The map is a sum of
    harmonics about the stylus axis.

    `residuals_mm` (k,) contains the residuals of a sphere that was fitted to the same touches with free centre and
    radius.

    The harmonics are made orthogonal to centre and radius over these touches, so the map does not change the fitted
    sphere. Raises DataError if there are too few touches or too few rings (circles of latitude of the ball) of touches.
    """
    terms = _terms(directions, stylus_axis)
    touches, unknowns = terms.shape
    sphere, harmonics = terms[:, :4], terms[:, 4:]
    # H⊥ = H - S S⁺ H: remove from the harmonics what centre and radius would absorb
    absorbed = np.linalg.lstsq(sphere, harmonics, rcond=None)[0]
    square = harmonics - sphere @ absorbed
    if touches <= unknowns or np.linalg.matrix_rank(square) < square.shape[1]:
        raise DataError(
            f"{touches} touches do not determine a pretravel map of {square.shape[1]} harmonics",
            hint="qualify with three rings of eight touches and the pole",
        )
    found = np.linalg.lstsq(square, residuals_mm, rcond=None)[0]
    left = residuals_mm - square @ found
    return PretravelMap(
        stylus_axis=stylus_axis,
        # H⊥ c = H c - S (S⁺H c): the terms of centre and radius take the negative of what the harmonics contain of them
        coefficients_mm=np.concatenate((-absorbed @ found, found)),
        noise_mm=float(np.sqrt(left @ left / (touches - unknowns))),
        largest_mm=float(np.abs(square @ found).max()),
    )


def _terms(directions: Array, stylus_axis: Array) -> Array:
    """Return the terms (k, 18) of the map: outward normal (3), constant 1, and 14 harmonics.

    The harmonics are wᵐ cos(ma) and wᵐ sin(ma), each times two powers of h: the two lowest powers, for each order m = 0
    … 3, that are independent of centre and radius. h is the height towards the ram, w the distance from the stylus axis
    and a the angle about it.
    """
    first, second = perpendiculars(stylus_axis)
    # a touch approaches against the outward normal
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
    """Return the unit vector (3,) of the approach direction for a touch at a given latitude and angle about the stylus
    axis.

    The latitude is measured from the equator of the ball and is positive towards the ram.
    """
    first, second = perpendiculars(stylus_axis)
    sideways = math.cos(angle_rad) * first + math.sin(angle_rad) * second
    return np.asarray(math.sin(latitude_rad) * stylus_axis - math.cos(latitude_rad) * sideways)
