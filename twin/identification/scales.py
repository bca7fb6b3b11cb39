"""Factors on the stated standard deviations of noise, prior and misfit."""

from __future__ import annotations

import math
from dataclasses import dataclass

from twin.identification.misfit import MISFIT_KINDS
from twin.identification.series_prior import STATIONARY_SHARE

OUTSIDE_FAMILY = 10.0
"""Factor from which the errors of a machine are not those of its family. Then the model explains them badly."""

OfAxes = tuple[float, float, float]


@dataclass(frozen=True)
class Scales:
    """Scales: factors on the standard deviations of the touch noise, of the parameter prior and of each kind of misfit.

    The Legendre series of the error motions have two scales of their own for each axis: `stationary_x` and so on for
    their stationary part, and `independent_x` and so on for their independent coefficients. The scale `prior` then
    applies to all other parameters.
    """

    noise: float = 1.0
    prior: float = 1.0
    mixed: float = 1.0
    waves_x: float = 1.0
    waves_y: float = 1.0
    waves_z: float = 1.0
    stationary_x: float = 1.0
    stationary_y: float = 1.0
    stationary_z: float = 1.0
    independent_x: float = 1.0
    independent_y: float = 1.0
    independent_z: float = 1.0

    @property
    def values(self) -> tuple[float, ...]:
        """All scales, in the order of the fields."""
        # `dataclasses.astuple` takes twenty times as long, a good part of the search for the likeliest scales
        return self.noise, self.prior, *self.kinds, *self.stationary, *self.independent

    @property
    def kinds(self) -> tuple[float, float, float, float]:
        """Scales of the kinds of misfit, in the order of `MISFIT_KINDS`: mixed terms, waves along X, waves along Y,
        waves along Z."""
        return self.mixed, self.waves_x, self.waves_y, self.waves_z

    @property
    def stationary(self) -> OfAxes:
        """Scales of the stationary part of the error motions of X, Y and Z."""
        return self.stationary_x, self.stationary_y, self.stationary_z

    @property
    def independent(self) -> OfAxes:
        """Scales of the independent coefficients of the error motions of X, Y and Z."""
        return self.independent_x, self.independent_y, self.independent_z

    @property
    def motions(self) -> float:
        """Scale (factor) on the prior rms of both parts of the error motions of all axes combined."""
        return math.hypot(*self.independent, *(STATIONARY_SHARE * scale for scale in self.stationary)) / math.sqrt(3.0)

    @property
    def of_machine(self) -> float:
        """Larger of the factors on the standard deviations of the family: that of the error motions of all axes, and
        that of all other errors of the machine."""
        return max(self.prior, self.motions)

    @property
    def misfit(self) -> float:
        """Scale (factor) on the prior rms of all kinds of misfit combined."""
        shares = MISFIT_KINDS.values()
        return math.sqrt(sum(share * scale**2 for share, scale in zip(shares, self.kinds, strict=True)))
