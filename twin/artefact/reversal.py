"""Reversal value of a linear axis from touches of oblique points of a ball. Each point is touched after the tested axis
has been preloaded from one side, and again after it has been preloaded from the other side.

During a touch, only another axis moves. It moves the tip against a point of the ball whose normal is inclined towards
the tested axis. A change of the preload direction displaces the tested axis by its lost motion. The tip therefore meets
the ball earlier or later by the lost motion times the tangent of the angle between the normal and the moving axis.
Errors of the touch itself (pretravel, play of the moving axis) are the same for both preload directions and cancel.
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
    """Point of a ball whose normal is oblique to two machine axes, and the touch at this point, which measures lost
    motion. The axes X, Y, Z are numbered 0, 1, 2.

    - `axis` is the axis whose lost motion is tested. It is preloaded, that is, moved in a known direction, before the
      touch.
    - `along` is the axis that moves during the touch.
    - `normal` (3,) is the unit vector from the centre of the ball to the point.
    - `direction` (3,) is the unit vector of the motion during the touch.
    """

    axis: int
    along: int
    normal: Array
    direction: Array

    @property
    def ratio(self) -> float:
        """Change of the latched position of the axis `along` per mm of lost motion of the axis `axis`.

        The change is the latched position after `axis` has been preloaded by upward motion minus the latched position
        after it has been preloaded by downward motion.
        """
        return float(self.normal[self.axis] / self.normal[self.along])


@dataclass(frozen=True)
class LostMotion:
    """Lost motion of an axis in mm with its standard uncertainty `sigma_mm`. The lost motion is positive if the axis
    lags behind its drive.

    `value_mm` is the deviation after downward motion minus the deviation after upward motion. This difference is the
    reversal value of ISO 230-2 with the opposite sign. `scatter_mm` is the standard deviation of touches of one point
    with the same preload direction, with `freedom` degrees of freedom; it is 0 if there are none.
    """

    value_mm: float
    sigma_mm: float
    touches: int
    scatter_mm: float
    freedom: int


def plan_oblique_touches(axis: int, stylus_axis: Array) -> tuple[ObliqueTouch, ObliqueTouch]:
    """Return the touches of two mirrored points of a ball whose normals are inclined towards `axis`. The touches are
    sensitive to the lost motion of this axis, and a straight stylus can reach both points.

    `stylus_axis` (3,) is the unit vector from the ram towards the tip. Raises DataError if it is not parallel to a
    machine axis.
    """
    ahead = int(np.argmax(np.abs(stylus_axis)))
    front = np.zeros(AXIS_COUNT)
    front[ahead] = -np.sign(stylus_axis[ahead])
    if abs(abs(float(stylus_axis[ahead])) - 1.0) > 1e-9:
        raise DataError("the stylus does not point along a machine axis")
    # A lateral axis is tested by touches along the stylus. The stylus axis is tested by touches along a lateral axis:
    # the same two inclined points, met from the side.
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
    """Fit the lost motion of an axis to all its touches by least squares. The mean latched position of each touched
    point is a further unknown.

    - `ratios` contains `ObliqueTouch.ratio` of each touch.
    - `upwards` is True for each touch before which the preloaded axis moved upwards last.
    - `points` contains the number of the touched point for each touch.
    - `latched_mm` contains the latched position of the moving axis for each touch.
    - `floor_mm` is the known repeatability of the probe. The standard uncertainty is computed from `floor_mm` or from
      the observed repeatability, whichever is larger.

    Raises DataError if every point was touched with only one preload direction.
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
    # A few touches that happen to agree would state too small an uncertainty; the probe's repeatability is its floor.
    return LostMotion(value, max(scatter, floor_mm) / math.sqrt(strength), len(reading), scatter, max(freedom, 0))


def _touch_point(axis: int, along: int, front: Array, beside: int, side: float) -> ObliqueTouch:
    normal = SLOPE * front
    normal[beside] = SLOPE * side
    direction = np.zeros(AXIS_COUNT)
    direction[along] = -np.sign(normal[along])
    return ObliqueTouch(axis, along, normal, direction)
