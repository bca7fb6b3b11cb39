"""Degrees of the mount and counts of the encoder; how long a turn takes. Pure arithmetic.

counts = direction * (angle - offset) * counts_per_degree, with
counts_per_degree = encoder counts per motor turn * motor turns / (shaft turns * 360).

The product is formed in rational numbers from the exact binary values and rounded once, half to even: the
count sent is the one nearest to the angle asked for, and counts -> degrees -> counts gives the same counts.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from fractions import Fraction

INT32_MAX = 2**31 - 1


@dataclass(frozen=True)
class AxisScale:
    """`counts_per_degree` is exact and positive; `direction` is 1 or -1."""

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
        density = Fraction(counts_per_revolution * motor_revolutions, shaft_revolutions * 360)
        return cls(density, direction, offset_deg)

    def counts(self, angle_deg: float) -> int:
        """The count nearest to an angle, half to even."""
        return round(self.direction * (Fraction(angle_deg) - Fraction(self.offset_deg)) * self.counts_per_degree)

    def angle_deg(self, counts: int) -> float:
        """The angle of a count, rounded once to float64."""
        return float(self.direction * Fraction(counts) / self.counts_per_degree + Fraction(self.offset_deg))

    def rate(self, degrees: float) -> int:
        """Degrees per s or per s² as counts per s or per s², never zero."""
        return max(1, round(Fraction(degrees) * self.counts_per_degree))


def turn_duration_s(distance_deg: float, speed_deg_per_s: float, acceleration_deg_per_s2: float) -> float:
    """Trapezoidal law from rest to rest: d/v + v/a, or 2*sqrt(d/a) when the speed is not reached."""
    distance = abs(distance_deg)
    if distance * acceleration_deg_per_s2 >= speed_deg_per_s**2:
        return distance / speed_deg_per_s + speed_deg_per_s / acceleration_deg_per_s2
    return 2.0 * math.sqrt(distance / acceleration_deg_per_s2)
