"""Conversion between mount angles in degrees and encoder counts, and the duration of a turn.

::

    counts = direction * (angle - offset) * counts_per_degree
    counts_per_degree = encoder counts per motor turn * motor turns / (shaft turns * 360)

The counts are computed with rational numbers from the exact binary values of the inputs. The result is rounded once,
half to even, so the count sent to the drive is the one nearest to the requested angle. A count that is converted to
degrees and back to a count does not change.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from fractions import Fraction

INT32_MAX = 2**31 - 1


@dataclass(frozen=True)
class AxisScale:
    """Scale of one axis: conversion between mount angles and encoder counts.

    `counts_per_degree` is an exact rational number and positive; `direction` is 1 or -1.
    """

    counts_per_degree: Fraction
    direction: int
    offset_deg: float

    @classmethod
    def of(
        cls,
        *,
        counts_per_revolution: int,
        motor_revolutions: int,
        shaft_revolutions: int,
        direction: int,
        offset_deg: float,
    ) -> AxisScale:
        # Encoder counts per turn of the shaft are counts per motor turn times the gear ratio; a turn has 360°.
        density = Fraction(counts_per_revolution * motor_revolutions, shaft_revolutions * 360)
        return cls(density, direction, offset_deg)

    def counts(self, angle_deg: float) -> int:
        """Return the encoder count nearest to a mount angle in degrees.

        If two counts are equally near, the even one is returned.
        """
        return round(self.direction * (Fraction(angle_deg) - Fraction(self.offset_deg)) * self.counts_per_degree)

    def angle_deg(self, counts: int) -> float:
        """Return the mount angle in degrees for an encoder count, rounded once to float64."""
        return float(self.direction * Fraction(counts) / self.counts_per_degree + Fraction(self.offset_deg))

    def rate(self, degrees: float) -> int:
        """Convert a rate in degrees per s or s² to encoder counts per s or s²; the result is at least 1."""
        # A rate that is rounded to 0 would never move the axis.
        return max(1, round(Fraction(degrees) * self.counts_per_degree))


def turn_duration_s(distance_deg: float, speed_deg_per_s: float, acceleration_deg_per_s2: float) -> float:
    """Return the duration in s of a turn from rest to rest with a trapezoidal velocity profile.

    With the distance d, the speed v and the acceleration a, the duration is d/v + v/a. If the turn is too short to
    reach the speed v, the duration is 2*sqrt(d/a).
    """
    distance = abs(distance_deg)
    # Both ramps together take v²/a of the way.
    if distance * acceleration_deg_per_s2 >= speed_deg_per_s**2:
        return distance / speed_deg_per_s + speed_deg_per_s / acceleration_deg_per_s2
    return 2.0 * math.sqrt(distance / acceleration_deg_per_s2)
