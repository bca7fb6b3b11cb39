"""Proof of a compensation table at held-out balls: does the table act, and does it make the machine better?

The balls are measured with the former table, whose corrections are c₀, and with the new one, c₁. Let e be the true
deviation of the machine, and let all vectors be projected on the directions that the poses leave free. The displayed
residuals are r₀ = -(e + c₀) + n₀ and r₁ = -(e + c₁) + n₁, with the noise n of the touches. The predicted change of the
residuals, d = c₀ - c₁, is known exactly. With ⟨u, v⟩ = uᵀM⁻¹v, two shares are computed from the measurements:

- the *change* β = ⟨d, r₁ - r₀⟩ / ⟨d, d⟩. It is 1 if the controller applies the new table in place of the former one, 0
  if the table has no effect, and -1 if the first table of a machine acts with the wrong sign. The errors of the machine
  and of the certificate cancel.
- the *gain* γ = -⟨d, r₀ + r₁⟩ / ⟨d, d⟩. It is expected to be 1 if the estimate is right. A table that acts, r₁ = r₀ +
  d, lowers the weighted square ⟨r, r⟩ by γ ⟨d, d⟩: γ is 0 if the table makes the machine neither better nor worse, and
  -3 if the first table of a machine was computed with the wrong sign.

The hypothesis of no effect is that the square does not fall: β ≤ 0 or γ ≤ 0. It is rejected if both shares exceed
`CRITICAL` times their standard deviation, which is that of the noise of the touches in both measurements. The
probability of an error is then at most 5 %, because each part is tested at this level (intersection-union test; R. L.
Berger, Technometrics 24, 1982). The residuals are those from the certified artefact: an error of its certificate is the
same in both measurements, and neither can show it.

Whether a table that works is accepted can be foreseen once r₀ is measured. With b = -⟨d, r₀⟩ / ⟨d, d⟩, the share of the
predicted change that the former residuals ask for, a table that acts gives β = 1 and γ = 2b - 1, apart from the noise
of the touches. The table is written only if the probability of acceptance is then at least `REQUIRED_POWER`. This
decision cannot raise the probability of an error: a table that is accepted has passed the test. Before anything is
measured, b is normally distributed about 1 with the covariance of the estimate, the certificate and the touches.

The metric M is the sum of the covariances of r₁ - r₀ and of r₀. Directions in which the touches or the estimate are
uncertain therefore count little, and the sum of the variances of β and b is as small as possible.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.special import chdtr, ndtr

from twin.arrays import Array
from twin.artefact.held_out_check import HeldOutCovariance, HeldOutTest

CRITICAL = 1.6448536269514722
"""Standard deviations that a normally distributed value exceeds to one side with a probability of 5 %."""

REQUIRED_POWER = 0.95
"""Smallest probability of acceptance with which a table is written."""

NO_GAIN = "kept, no gain that can be shown"
"""Result of a run whose new table could not be proved: the active compensation is kept, and nothing is written."""

_DRAWS = 400


@dataclass(frozen=True)
class MeasuredEffect:
    """Measured effect of a table at the held-out balls.

    `change` and `gain` are the shares β and γ, which are 1 if the table has the predicted effect. Both must reach
    `limit`. `consistency` compares the residuals with the new table with their prediction; its normalised χ² must not
    exceed `max_chi2`.
    """

    change: float
    gain: float
    limit: float
    consistency: HeldOutTest
    max_chi2: float

    @property
    def is_shown(self) -> bool:
        """True if the hypothesis that the table has no effect is rejected at a level of 5 %."""
        return min(self.change, self.gain) >= self.limit

    @property
    def is_consistent(self) -> bool:
        return self.consistency.chi2_normalised <= self.max_chi2

    @property
    def accepted(self) -> bool:
        return self.is_shown and self.is_consistent


@dataclass(frozen=True, eq=False)
class EffectTest:
    """Test of the effect of a table, with f directions that the poses of the held-out balls leave free.

    `weights` (f,) in 1/mm are M⁻¹d / ⟨d, d⟩. `noise` is the standard deviation of β and γ that is due to the touches,
    and `former_sd` is that of b before anything is measured. `residuals` is the covariance of the residuals with the
    new table. They agree with it if their normalised χ² does not exceed `max_chi2`.
    """

    weights: Array
    noise: float
    former_sd: float
    residuals: HeldOutCovariance
    max_chi2: float

    @classmethod
    def of(
        cls, change: Array, residuals: HeldOutCovariance, touches_before: Array, noise: float, max_chi2: float
    ) -> EffectTest:
        """Return the test of a table that is to change the projected residuals by `change` (f,) in mm.

        `residuals` is the covariance of the residuals with the new table, and `touches_before` (f, f) in mm² that of
        the touches with the former table. `noise` is the factor of the true on the stated standard deviation of the
        touches.
        """
        towards = np.linalg.solve(residuals.total + residuals.touches + touches_before, change)
        square = float(change @ towards)
        if square <= 0.0:  # the tables are equal
            return cls(np.zeros_like(change), math.inf, 0.0, residuals, max_chi2)
        weights = np.asarray(towards / square)
        before, after, certificate, field = (
            float(weights @ covariance @ weights)
            for covariance in (touches_before, residuals.touches, residuals.certificate, residuals.field)
        )
        return cls(
            weights,
            noise * math.sqrt(before + after),
            math.sqrt(max(noise**2 * before + certificate + field, 0.0)),
            residuals,
            max_chi2,
        )

    @property
    def limit(self) -> float:
        """Smallest β and γ that reject the hypothesis of no effect."""
        return CRITICAL * self.noise

    def power(self, before_mm: Array) -> float:
        """Return the probability that a table that works is accepted, if the residuals with the former table were
        `before_mm` (n, 3) in mm."""
        return self._power(float(-self.weights @ self.residuals.projected(before_mm)))

    def _power(self, former: float) -> float:
        """Return the probability of acceptance if b is `former`."""
        # β = 1 + n and γ = 2b - 1 - n reach the limit, with the same noise n
        if math.isinf(self.noise):
            return 0.0
        lowest, highest = self.limit - 1.0, 2.0 * former - 1.0 - self.limit
        shown = ndtr(highest / self.noise) - ndtr(lowest / self.noise)
        freedom = len(self.weights)
        return float(max(shown, 0.0) * chdtr(freedom, self.max_chi2 * freedom))

    def expected_power(self, deviate: float) -> float:
        """Return the probability that a table that works is written and accepted, if b exceeds its expected value of 1
        by `deviate` standard deviations."""
        power = self._power(1.0 + deviate * self.former_sd)
        return power if power >= REQUIRED_POWER else 0.0

    def measured(self, before_mm: Array, after_mm: Array) -> MeasuredEffect:
        """Return the effect measured with residuals (n, 3) in mm with the former and with the new table."""
        before, after = (self.residuals.projected(one) for one in (before_mm, after_mm))
        return MeasuredEffect(
            change=float(self.weights @ (after - before)),
            gain=float(-self.weights @ (before + after)),
            limit=self.limit,
            consistency=self.residuals.test(after_mm),
            max_chi2=self.max_chi2,
        )


def expected_power(change: Array, residuals: HeldOutCovariance, max_chi2: float) -> float:
    """Return the probability that a table is written and accepted, if it works, before anything is measured.

    The projected change is normally distributed with the covariance `change` (f, f) in mm² over the tables that may be
    computed; `residuals` and `max_chi2` are those of `EffectTest.of`, and the touches have the stated noise. The result
    is a mean over random changes that are always the same.
    """
    variances, directions = np.linalg.eigh(change)
    draws = np.random.default_rng(0).normal(size=(_DRAWS, len(change) + 1))
    powers = []
    for deviate, *draw in draws:
        drawn = directions @ (np.sqrt(np.maximum(variances, 0.0)) * draw)
        test = EffectTest.of(drawn, residuals, residuals.touches, 1.0, max_chi2)
        powers.append(test.expected_power(deviate))
    return float(np.mean(powers))
