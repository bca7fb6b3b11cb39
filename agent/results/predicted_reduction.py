"""Predicted reduction of the mean square residual of the held-out balls by a new compensation table, and the test
whether the measured reduction reaches it in spite of noise.

Let s be the residuals of the held-out balls with the former table and n the noise of the touches, in f independent
components of standard deviation σ. The measured square |s + n|² has the variance 4 |s|² σ² + 2 f σ⁴. The measured
reduction is the difference of two such squares, before and after the table is activated. Without any effect of the
table its expectation is zero, and both have the same s. With the predicted effect its expectation is the prediction.

A table is accepted if the measured reduction reaches a threshold. If the prediction is *detectable* (`can_be_shown`),
the threshold is the required fraction of the prediction, but at least `SIGNIFICANCE` standard deviations of the
reduction that noise alone produces. A prediction is detectable if it exceeds this threshold by `POWER` standard
deviations. A table without effect is then accepted with a probability of about 1 %, and a table with the predicted
effect refused with at most about 5 %.

If the prediction is not detectable, no threshold separates the two cases. The threshold is then chosen so that a table
with the predicted effect is refused with a probability of about 1 %; how often a table without effect is accepted
depends on the prediction. If the prediction is small compared with the noise, a table is refused only if the residuals
rise by more than the noise explains.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from twin.units import UM_PER_MM

SIGNIFICANCE = 2.33
"""Standard deviations that noise exceeds to one side with a probability of 1 %."""

POWER = 1.645
"""Standard deviations that noise exceeds to one side with a probability of 5 %.

It is smaller than `SIGNIFICANCE` because the two errors are not equally bad: a refused table costs a run, and a machine
that is not corrected because the proof might fail keeps all of its error.
"""


def noise_of_square(mean_square: float, freedom: int, variance: float) -> float:
    """Return the standard deviation of the measured mean square of a ball's residual that is due to touch noise alone.

    `mean_square` is the measured mean square, with the noise in it, from `freedom` independent components. `variance`
    is that of the noise of one component. The unit is that of `mean_square`.
    """
    systematic = max(mean_square * freedom / 3.0 - freedom * variance, 0.0)  # the mean of |s + n|² is |s|² + f σ²
    return 3.0 / freedom * math.sqrt(4.0 * systematic * variance + 2.0 * freedom * variance**2)


@dataclass(frozen=True)
class PredictedReduction:
    """Reduction of the mean square of the held-out balls that is predicted for a new table, `square`. `idle_noise` is
    the standard deviation of the measured reduction if the table has no effect, `noise` that if it has the predicted
    one. At most the fraction `max_missing_fraction` of the prediction may be missing. All squares are in mm².
    """

    square: float
    idle_noise: float
    noise: float
    max_missing_fraction: float

    @classmethod
    def of(
        cls, before: float, square: float, freedom: int, variance: float, max_missing_fraction: float
    ) -> PredictedReduction:
        """Return the prediction for a mean square `before`, which contains the noise of `freedom` components with
        `variance` each, if the new table is to reduce it by `square`."""
        former = noise_of_square(before, freedom, variance)
        later = noise_of_square(before - square, freedom, variance)
        return cls(square, math.sqrt(2.0) * former, math.hypot(former, later), max_missing_fraction)

    @property
    def threshold(self) -> float:
        """Smallest measured reduction with which the table is accepted."""
        required = (1.0 - self.max_missing_fraction) * self.square
        if self.can_be_shown:
            return max(required, SIGNIFICANCE * self.idle_noise)
        return min(required, self.square - SIGNIFICANCE * self.noise)

    @property
    def smallest_shown(self) -> float:
        """Smallest predicted reduction that can be shown in this noise."""
        return max(POWER * self.noise / self.max_missing_fraction, SIGNIFICANCE * self.idle_noise + POWER * self.noise)

    @property
    def can_be_shown(self) -> bool:
        return self.square >= self.smallest_shown

    @property
    def text(self) -> str:
        """Predicted reduction, and the smallest that can be shown, in words."""
        predicted_um2, smallest_um2 = (UM_PER_MM**2 * square for square in (self.square, self.smallest_shown))
        return (
            f"the mean square of the held-out balls is predicted to fall by {predicted_um2:.2f} µm², and they can show "
            f"{smallest_um2:.2f} µm² or more in their noise"
        )

    def is_reached_by(self, measured: float) -> bool:
        """Return True if the table is accepted with the measured reduction in mm². The reduction is then greater than
        zero if the prediction can be shown."""
        return measured >= self.threshold and (measured > 0.0 or not self.can_be_shown)
