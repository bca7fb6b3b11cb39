"""Reversal of a linear axis from touches of oblique places of one ball, the axis pre-loaded from either side.

The tip is led against a place whose normal leans towards the axis asked for, by another axis alone. Coming from the
other side, the pre-loaded axis stands elsewhere by its lost motion, and the ball is met earlier or later by that times
the tangent of the slope. What the touch itself loses (pretravel, play of the axis that moves) is the same both times.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from twin.arrays import Array
from twin.errors import DataError

AXIS_COUNT = 3
SLOPE = math.sqrt(0.5)
"""Places at 45°: the lost motion shows in full in the axis that moves."""


@dataclass(frozen=True)
class ObliqueTouch:
    """A place on the ball, and how it is touched: `along` moves, `axis` has been pre-loaded before (0, 1, 2: X, Y, Z).

    `normal` (3,): from the ball's centre to the place; `direction` (3,): unit vector of the touch.
    """

    axis: int
    along: int
    normal: Array
    direction: Array

    @property
    def ratio(self) -> float:
        """By how much the latched position of `along` grows for each mm of lost motion of `axis`, reached upwards
        instead of downwards."""
        return float(self.normal[self.axis] / self.normal[self.along])


@dataclass(frozen=True)
class LostMotion:
    """mm; positive where the axis lags behind its drive. Deviation reached downwards less that reached upwards: the
    reversal value of ISO 230-2 with the opposite sign. `sigma_mm`: its standard uncertainty."""

    value_mm: float
    sigma_mm: float
    touches: int


def plan_oblique_touches(axis: int, stylus_axis: Array) -> tuple[ObliqueTouch, ObliqueTouch]:
    """Two mirrored places that tell of `axis`, both before the ball, where a straight stylus gets to.

    `stylus_axis` (3,): unit vector along a machine axis, from the ram towards the tip. DataError for a slanting one.
    """
    ahead = int(np.argmax(np.abs(stylus_axis)))
    front = np.zeros(AXIS_COUNT)
    front[ahead] = -np.sign(stylus_axis[ahead])
    if abs(abs(float(stylus_axis[ahead])) - 1.0) > 1e-9:
        raise DataError("the stylus does not point along a machine axis")
    beside = axis if axis != ahead else next(other for other in range(AXIS_COUNT) if other != ahead)
    along = ahead if axis != ahead else beside
    first, second = (_place(axis, along, front, beside, side) for side in (1.0, -1.0))
    return first, second


def fit_lost_motion(
    ratios: Sequence[float],
    upwards: Sequence[bool],
    places: Sequence[int],
    latched_mm: Sequence[float],
    floor_mm: float,
) -> LostMotion:
    """Least squares over all touches of an axis, with a level of its own for each place.

    `latched_mm`: of the axis that moved; `upwards`: whether the pre-loaded axis came from below. Of the scatter found
    and `floor_mm`, known of the probe, the larger one counts. DataError where a place was touched from one side only.
    """
    place = np.asarray(places)
    lever = 0.5 * np.asarray(ratios) * np.where(np.asarray(upwards), 1.0, -1.0)
    reading = np.asarray(latched_mm, dtype=np.float64)
    numbers = np.unique(place)
    for number in numbers:
        here = place == number
        lever[here] -= lever[here].mean()
        reading[here] -= reading[here].mean()
    strength = float(lever @ lever)
    if not strength > 0.0:
        raise DataError("every place was touched from one side only", hint="pre-load the axis from both sides")
    value = float(lever @ reading) / strength
    freedom = len(reading) - len(numbers) - 1
    left = reading - value * lever
    scatter = math.sqrt(float(left @ left) / freedom) if freedom > 0 else 0.0
    return LostMotion(value, max(scatter, floor_mm) / math.sqrt(strength), len(reading))


def _place(axis: int, along: int, front: Array, beside: int, side: float) -> ObliqueTouch:
    normal = SLOPE * front
    normal[beside] = SLOPE * side
    direction = np.zeros(AXIS_COUNT)
    direction[along] = -np.sign(normal[along])
    return ObliqueTouch(axis, along, normal, direction)
