"""Test if a night fits what earlier nights predict, and estimation of the size of the machine's drift.

Before the measurement, the P unknowns z of the identification have the mean m and the covariance C + f² W. C is the
covariance of the earlier estimate. W is the diagonal covariance of the stated drift since then (process noise), and f
is the drift factor, by which the machine drifts more or less than stated. The innovation r, the difference between the
measured ball centres and those expected for z = m, then has the covariance S + f² A W Aᵀ, where A is the design matrix
and S is the covariance without drift. With the eigenvalues λ and the eigenvectors U of the matrix W^½ AᵀS⁻¹A W^½, and
with t = Uᵀ W^½ AᵀS⁻¹r, the log likelihood of f relative to f = 0, and the χ² of the innovation, are

    L(f) = ½ Σ [f² t² / (1 + f² λ) - ln(1 + f² λ)],    χ²(f) = rᵀS⁻¹r - Σ f² t² / (1 + f² λ).

A priori, f is log-normal about the value learned from earlier nights. The posterior of ln f becomes the prior of the
next night (after a small widening, since a drift is not the same all the year).

Three statistics test the night. χ² per equation is compared with the F distribution, because the touch noise was
estimated, too. It detects balls that are not as predicted in any way. The second is twice the difference between the
largest L and the largest sum of L and the log prior of f, relative to the maximum of this prior. If both were normal
distributions, it would have a χ² distribution with one degree of freedom. It detects a change of the whole machine that
is larger than the drift learned so far. The third is the largest likelihood ratio of a jump of one of the 21 errors
(module `step_detection`). The expected likelihood ratio of a jump is 1 if there was none, so the probability that it
exceeds R is at most 1/R (Markov's inequality), and 21/R for the largest of 21.

The nights together are tested for errors that drift in one direction (module `constant_drift`). If one is found, its
rate becomes an unknown of the nights: the comparison is repeated with the estimate of the night before, corrected for
the drift until then, so that neither the estimate nor the drift factor has to follow it by a random walk.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import chdtrc, fdtrc

from twin.arrays import Array
from twin.artefact.artefact import Artefact
from twin.artefact.observations import Observations
from twin.identification.drift_trend import DriftTrend, NightMeasurement
from twin.identification.jump import ERRORS, SuspectedJump
from twin.identification.options import Options
from twin.identification.prior_from_estimate import (
    UNKNOWN_LOG_DEVIATION,
    CarriedOverPrior,
    DriftFactor,
    shared_unknowns,
)
from twin.machine.machine_population import Family
from twin.monitoring.constant_drift import FoundDrift, begun_drift, found_drift, still_drifts
from twin.monitoring.step_detection import Innovation, PossibleJump, innovation

FALSE_ALARM = 1e-3
"""Probability that a night is said not to fit although the machine drifts as before."""

_WIDENING = 0.2  # standard deviation of the change of ln f from one night to the next
_SEARCHED = 5.0 * UNKNOWN_LOG_DEVIATION  # largest change of ln f in one night that is searched
# odd, so that the prior's own factor is one of the points
_POINTS = 401


@dataclass(frozen=True, eq=False)
class NightFit:
    """Comparison of a night with the prediction from earlier nights.

    `prior` is the prior with which the night is to be identified. It includes the drift since the earlier estimate,
    with the drift factor (factor on the stated process noise) as learned from earlier nights and from this night.
    `expected_factor` is the drift factor before this night.

    `chi2_normalised` is the χ² of the innovation per equation, for the drift expected before this night. `probability`
    is the probability of a night that contradicts the prediction as much as this one or more, if the machine drifts as
    before; `fits` is True if it is not below the accepted probability of a false alarm. `suspects` are the errors whose
    sudden change would explain a night that does not fit, the likeliest first; it is empty if the night fits. `drift`
    is the drift in one direction that all nights together show; None if there is none.
    """

    prior: CarriedOverPrior
    expected_factor: float
    chi2_normalised: float
    probability: float
    fits: bool
    suspects: tuple[PossibleJump, ...] = ()
    drift: FoundDrift | None = None

    @property
    def suspect(self) -> SuspectedJump | None:
        """Likeliest sudden change; None if the night fits."""
        return self.suspects[0].jump if self.suspects else None

    @property
    def factor(self) -> float:
        """Drift factor (factor on the stated process noise) that was used for `prior`."""
        return self.prior.drift_factor.value


def compare_with_nights_before(
    family: Family,
    observations: Observations,
    artefact: Artefact,
    known: CarriedOverPrior,
    process_noise: ArrayLike,
    *,
    nights: float = 1.0,
    options: Options | None = None,
    night_false_alarm: float = FALSE_ALARM,
) -> NightFit:
    """Compare measured ball centres, without outliers, with the estimate `known` of an earlier night.

    `known` does not include the drift since then. `process_noise` (p,) is the stated standard deviation of the change
    of each of the p parameters per night, in mm or rad, and `nights` is the number of nights. `options` are those of
    the identification of this night. `night_false_alarm` is the accepted probability of a false alarm of the test of
    the night. Raises DataError if the model, the artefact or the balls do not match.
    """
    night = _Night(family, observations, artefact, process_noise, nights, options, night_false_alarm)
    known = night.fitting(known)
    fit, trend = night.compare(known)
    begun = begun_drift(known.unknowns, known.trend, trend)
    if begun is not None:
        known = known.with_rates(*begun)
        fit, trend = night.compare(known)
    elif not fit.fits:
        trend = replace(trend, starts=())
    if trend.rates is not None and not still_drifts(trend.rates):
        trend = replace(trend, rates=None)
    drift = None if trend.rates is None else found_drift(known.unknowns, trend.rates)
    return replace(fit, prior=replace(fit.prior, trend=trend), drift=drift)


@dataclass(frozen=True, eq=False)
class _Night:
    """Ball centres of a night, `nights` nights after the last one, and what is stated about the drift since then."""

    family: Family
    observations: Observations
    artefact: Artefact
    process_noise: ArrayLike
    nights: float
    options: Options | None
    night_false_alarm: float

    @staticmethod
    def fitting(known: CarriedOverPrior) -> CarriedOverPrior:
        """Return `known` without a trend that refers to other unknowns."""
        fits = known.trend.size in (None, known.unknowns.blocks.size)
        return known if fits else replace(known, trend=DriftTrend())

    def compare(self, known: CarriedOverPrior) -> tuple[NightFit, DriftTrend]:
        """Return the comparison with `known`, and the trend after this night."""
        moved, nights = known.drifted(self.nights), self.nights
        before = self._innovation(moved)
        drift = _DriftLikelihood.of(before, moved, moved.walk_variances(self.process_noise, nights))
        expected = known.drift_factor
        chi2 = (before.chi2 - drift.explained(expected.value)) / before.rows
        walked = known.after(self.process_noise, nights)
        against = self._innovation(walked)
        chances = [
            _exceedance(chi2, before.rows, known.degrees_of_freedom),
            len(ERRORS) * math.exp(-max(against.suspects()[0].evidence, 0.0)),
        ]
        # Without information about the drift (no process noise, or none that the balls show), the factor stays.
        learned = expected
        if drift.informative:
            widened = replace(expected, log_deviation=math.hypot(expected.log_deviation, _WIDENING))
            chances.append(drift.probability_of_larger(widened))
            learned = drift.posterior(widened)
        probability = min(1.0, len(chances) * min(chances))  # Bonferroni
        fits = probability >= self.night_false_alarm
        if not fits and drift.informative:
            learned = drift.posterior(DriftFactor(expected.value))  # a sudden change has a size of its own
        prior = replace(known, drift_factor=learned).after(self.process_noise, nights)
        trend = moved.trend.after_night(self._measurement(moved, self._innovation(prior)), nights)
        return NightFit(prior, expected.value, chi2, probability, fits, () if fits else against.possible_jumps()), trend

    def _innovation(self, prior: CarriedOverPrior) -> Innovation:
        return innovation(self.family, self.observations, self.artefact, prior, self.options)

    @staticmethod
    def _measurement(known: CarriedOverPrior, found: Innovation) -> NightMeasurement:
        there, here = shared_unknowns(known.unknowns, found.unknowns)
        blocks = found.unknowns.blocks
        return NightMeasurement(
            found.score, found.information, found.covariance, there, here, blocks.drift.start, blocks.parameters.stop
        )


@dataclass(frozen=True, eq=False)
class _DriftLikelihood:
    """Likelihood of the drift factor f, by the eigenvalues λ and the squares t² of the module's formulas."""

    eigenvalues: Array
    squares: Array

    @classmethod
    def of(cls, before: Innovation, known: CarriedOverPrior, walk_variances: Array) -> _DriftLikelihood:
        """Return the likelihood from the innovation without drift. `walk_variances` (P,) belongs to the unknowns of
        `known`; the artefact of this night may have other unknowns, but it does not walk."""
        there, here = known.unknowns.blocks, before.unknowns.blocks
        walk = np.zeros(len(before.score))
        walk[here.parameters] = np.sqrt(walk_variances[there.parameters])
        if known.unknowns.modes is not None:
            walk[here.misfit] = np.sqrt(walk_variances[there.misfit])
        values, vectors = np.linalg.eigh(walk[:, None] * before.information * walk)
        return cls(np.maximum(values, 0.0), np.square(vectors.T @ (walk * before.score)))

    @property
    def informative(self) -> bool:
        return bool(self.eigenvalues[-1] > 0.0)

    def explained(self, factor: float) -> float:
        """Return the part of χ² that the drift explains if it has this factor."""
        return float((factor**2 * self.squares / (1.0 + factor**2 * self.eigenvalues)).sum())

    def posterior(self, prior: DriftFactor) -> DriftFactor:
        """Return the drift factor after this night."""
        logs, weights = self._searched(prior), self._log_likelihoods(prior) + self._log_prior(prior)
        weights = np.exp(weights - weights.max())
        weights /= weights.sum()
        mean = float(weights @ logs)
        deviation = math.sqrt(float(weights @ (logs - mean) ** 2))
        return DriftFactor(math.exp(mean), min(deviation, UNKNOWN_LOG_DEVIATION))

    def probability_of_larger(self, prior: DriftFactor) -> float:
        """Return the probability that the likeliest factor exceeds the median of `prior` as much as in this night or
        more."""
        likelihoods = self._log_likelihoods(prior)
        if self._searched(prior)[likelihoods.argmax()] <= math.log(prior.value):
            return 1.0
        conflict = likelihoods.max() - (likelihoods + self._log_prior(prior)).max()
        return float(chdtrc(1.0, 2.0 * conflict))

    def _log_likelihoods(self, prior: DriftFactor) -> Array:
        square = np.exp(2.0 * self._searched(prior))[:, None]
        drifted = 1.0 + square * self.eigenvalues
        return np.asarray(0.5 * (square * self.squares / drifted - np.log(drifted)).sum(axis=1))

    @staticmethod
    def _log_prior(prior: DriftFactor) -> Array:
        return -0.5 * np.square(np.linspace(-_SEARCHED, _SEARCHED, _POINTS) / prior.log_deviation)

    @staticmethod
    def _searched(prior: DriftFactor) -> Array:
        return math.log(prior.value) + np.linspace(-_SEARCHED, _SEARCHED, _POINTS)


def _exceedance(chi2_normalised: float, rows: int, degrees_of_freedom: float) -> float:
    """Return the probability of a larger χ² per equation if the scale of the noise was estimated from measurements with
    these degrees of freedom."""
    if math.isinf(degrees_of_freedom):
        return float(chdtrc(rows, rows * chi2_normalised))
    return float(fdtrc(rows, degrees_of_freedom, chi2_normalised))
