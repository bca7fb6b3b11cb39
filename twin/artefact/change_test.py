"""Test whether the measured change of held-out balls is the change that a new compensation table should make.

The balls are measured with the former table, whose corrections are c₀, and with the new one, c₁. The displayed
residuals change by r₁ - r₀ = c₀ - a + n, if the controller applies the correction a, with the noise n of the touches in
both measurements. The deviations of the machine and the errors of the certificate cancel, so this test is far sharper
than a comparison of r₁ with its prediction. All vectors are projected on the directions that the poses leave free.

With χ²(a) = (r₁ - r₀ - c₀ + a)ᵀ N⁻¹ (…) and the covariance N of n, the odds of a correction a against c₁ are the ratio
of their likelihoods, exp((χ²(c₁) - χ²(a)) / 2). What the noise of the touches does not contain, for instance a drift of
the machine between the measurements, makes all χ² larger: the difference is therefore divided by χ² per degree of
freedom of the best explanation, if that exceeds 1.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import chdtri

from twin.arrays import Array
from twin.artefact.held_out_check import HeldOutCovariance

DECISIVE_ODDS = 1000.0
"""Odds from which another correction than that of the new table counts as applied. A table that is applied as written
meets such odds by chance with a probability of at most 0.1 % for each other correction, and for all together if the
odds are divided by their number."""

_FALSE_ALARM = 1e-4


@dataclass(frozen=True, eq=False)
class ChangeTest:
    """Measured change of the residuals of held-out balls, in f directions that the poses leave free.

    `measured` (f,) is r₁ - r₀ - c₀ in mm, which is -a and noise if the correction a is applied. `whitening` (f, f) in
    1/mm turns the noise of the touches into independent values of unit variance.
    """

    measured: Array
    whitening: Array

    @classmethod
    def of(cls, change: Array, residuals: HeldOutCovariance, touches_before: Array, noise: float) -> ChangeTest:
        """Return the test of the projected `change` (f,) in mm: the residuals with the new table minus those with the
        former one, minus the corrections of the former one.

        `residuals` is the covariance of the residuals with the new table, and `touches_before` (f, f) in mm² that of
        the touches with the former one. `noise` is the factor of the true on the stated standard deviation of the
        touches.
        """
        covariance = noise**2 * (residuals.touches + touches_before)
        return cls(change, np.linalg.inv(np.linalg.cholesky(covariance)))

    @property
    def freedom(self) -> int:
        return len(self.measured)

    def chi2_normalised(self, correction: Array) -> float:
        """Return χ² per degree of freedom if the projected `correction` (f,) in mm is applied. Only the noise of the
        touches counts, so the value of the right correction is about 1."""
        return float(np.sum((self.whitening @ (self.measured + correction)) ** 2)) / self.freedom

    def log_odds(self, corrections: Sequence[Array], against: Array) -> Array:
        """Return the natural logarithms (k,) of the odds that each of the k projected `corrections` (f,) in mm is
        applied, and not the correction `against`."""
        chi2 = np.array([self.chi2_normalised(one) for one in (*corrections, against)])
        return np.asarray(0.5 * self.freedom * (chi2[-1] - chi2[:-1]) / max(float(chi2.min()), 1.0))

    def share(self, correction: Array) -> float:
        """Return the share of the projected `correction` (f,) in mm that explains the measured change best; 1 if the
        correction is zero."""
        expected = self.whitening @ correction
        square = float(expected @ expected)
        return float(-(expected @ (self.whitening @ self.measured)) / square) if square > 0.0 else 1.0

    def limit(self, stated: float) -> float:
        """Return the largest normalised χ² of a change that counts as that of the new table: `stated`, but not less
        than a value that few degrees of freedom exceed by chance with a probability of 0.01 %."""
        return max(stated, float(chdtri(self.freedom, _FALSE_ALARM)) / self.freedom)


def odds_text(log_odds: float) -> str:
    """Return odds in words. Odds above a million to one are not stated more closely: no model is that exact."""
    if log_odds > math.log(1e6):
        return "more than 1,000,000 to 1"
    return f"{math.exp(log_odds):,.0f} to 1"
