"""Reversal value of a linear axis from touches of oblique points of a ball, with the axis preloaded from either side.

Another axis alone moves the tip against a point whose normal leans towards the tested axis. If the preload of the
tested axis is changed from one side to the other, this axis is displaced by its lost motion. The tip then meets the
ball earlier or later by the lost motion times the tangent of the slope. Errors of the touch itself (pretravel, play of
the moving axis) are equal in both cases and cancel.
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
"""Components of the unit normals along the tested and the moving axis.

At 45° the reading of the moving axis changes by the full lost motion (tangent 1).
"""


@dataclass(frozen=True)
class ObliqueTouch:
    """Point on the ball and its touch; axes are numbered 0, 1, 2 for X, Y, Z.

    `axis`: tested axis, which is preloaded; `along`: axis that moves during the touch; `normal` (3,): unit vector from
    the ball's centre to the point; `direction` (3,): unit vector of the touch.
    """

    axis: int
    along: int
    normal: Array
    direction: Array

    @property
    def ratio(self) -> float:
        """Change of the latched position of `along` per mm of lost motion.

        The change is from a touch with `axis` preloaded downwards to a touch with it preloaded upwards.
        """
        return float(self.normal[self.axis] / self.normal[self.along])


@dataclass(frozen=True)
class LostMotion:
    """Lost motion in mm, positive if the axis lags behind its drive, with its standard uncertainty `sigma_mm`.

    `value_mm` is the deviation after moving downwards minus the deviation after moving upwards, which is the reversal
    value of ISO 230-2 with the opposite sign.
    """

    value_mm: float
    sigma_mm: float
    touches: int


def plan_oblique_touches(axis: int, stylus_axis: Array) -> tuple[ObliqueTouch, ObliqueTouch]:
    """Return two mirrored points sensitive to `axis`, both on the side of the ball that a straight stylus reaches.

    `stylus_axis` (3,): unit vector along a machine axis, from the ram towards the tip. Raises DataError if it is not
    along a machine axis.
    """
    ahead = int(np.argmax(np.abs(stylus_axis)))
    front = np.zeros(AXIS_COUNT)
    front[ahead] = -np.sign(stylus_axis[ahead])
    if abs(abs(float(stylus_axis[ahead])) - 1.0) > 1e-9:
        raise DataError("the stylus does not point along a machine axis")
    beside = axis if axis != ahead else next(other for other in range(AXIS_COUNT) if other != ahead)
    along = ahead if axis != ahead else beside
    first, second = (_touch_point(axis, along, front, beside, side) for side in (1.0, -1.0))
    return first, second


def fit_lost_motion(
    ratios: Sequence[float],
    upwards: Sequence[bool],
    points: Sequence[int],
    latched_mm: Sequence[float],
    floor_mm: float,
) -> LostMotion:
    """Fit the lost motion to all touches of an axis by least squares, with a separate level for each touched point.

    Each touch has one entry in every list. `ratios`: `ObliqueTouch.ratio`; `upwards`: True if the preloaded axis moved
    upwards last; `points`: number of the touched point; `latched_mm`: position of the moving axis. The standard
    uncertainty uses the larger of the observed repeatability and `floor_mm`, the known repeatability of the probe.
    Raises DataError if every point was touched with one preload direction only.
    """
    point = np.asarray(points)
    # reading_i = level(point) ± ½ ratio_i · lost motion; the levels are removed by centring per point
    lever = 0.5 * np.asarray(ratios) * np.where(np.asarray(upwards), 1.0, -1.0)
    reading = np.asarray(latched_mm, dtype=np.float64)
    numbers = np.unique(point)
    for number in numbers:
        here = point == number
        lever[here] -= lever[here].mean()
        reading[here] -= reading[here].mean()
    strength = float(lever @ lever)
    if not strength > 0.0:
        raise DataError("every point was touched from one side only", hint="preload the axis from both sides")
    value = float(lever @ reading) / strength
    freedom = len(reading) - len(numbers) - 1
    left = reading - value * lever
    scatter = math.sqrt(float(left @ left) / freedom) if freedom > 0 else 0.0
    return LostMotion(value, max(scatter, floor_mm) / math.sqrt(strength), len(reading))


def _touch_point(axis: int, along: int, front: Array, beside: int, side: float) -> ObliqueTouch:
    normal = SLOPE * front
    normal[beside] = SLOPE * side
    direction = np.zeros(AXIS_COUNT)
    direction[along] = -np.sign(normal[along])
    return ObliqueTouch(axis, along, normal, direction)
