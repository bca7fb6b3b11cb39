"""Distributions of the volumetric error (VE) and of the volumetric compensated error (VCE), given an estimate.

The mean square of a field is a quadratic form of its parameters. This module computes the distribution of a quadratic
form of Gaussian variables with several possible means and covariances.

Each possible pair of mean and covariance is equally probable.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import ndtri

from twin.arrays import Array, as_points, as_vector
from twin.errors import DataError
from twin.identification.estimate import Estimate
from twin.identification.predicted import field_forms
from twin.machine.volumetric import VolumetricRms
from twin.uncertainty.quadratic_distribution import QuadraticDistribution, root_between
from twin.uncertainty.scale_mixture import MixtureComponent, mixture_components

_LEAST_SPREAD = 1e-9  # relative standard deviation below which rounding decides
_OUTERMOST = 1e-12
"""Smallest probability that has a quantile, and smallest distance of one to 1: rounding hides what lies beyond."""
_LEAST_PROBABILITY = 1e-300
_ROUNDING = 1e-16
_MOST_STEPS = 60  # each is at least twice as long as the one before
_TOLERANCE, _OF_SPREAD = 1e-12, 1e-6  # of ln Q, and as a share of its logarithmic deviation
_BEYOND = 1.1  # step of the search for a quantile beyond where a log-normal distribution has it
_SHORTEST = 1e-3  # step in standard deviations that is taken in any case


@dataclass(frozen=True, eq=False)
class QuadraticMixture:
    """Distribution of a quadratic form Q as a mixture of the distributions `parts`, which have equal weights."""

    parts: tuple[QuadraticDistribution, ...]

    @property
    def mean(self) -> float:
        return float(np.mean([part.mean for part in self.parts]))

    @property
    def variance(self) -> float:
        return float(np.mean([part.variance + part.mean**2 for part in self.parts])) - self.mean**2

    def exceeds(self, value: float) -> float:
        """Return the probability that the quadratic form Q is greater than `value`."""
        return float(np.mean([part.exceeds(value) for part in self.parts]))

    def at_most(self, value: float) -> float:
        """Return the probability that the quadratic form Q is at most `value`."""
        return float(np.mean([part.at_most(value) for part in self.parts]))

    def quantile(self, probability: float) -> float:
        """Return the value that the quadratic form Q does not exceed with the given probability.

        Raises DataError if `probability` is not between 10⁻¹² and 1 - 10⁻¹², or if no quantile is found.
        """
        if not _OUTERMOST <= probability <= 1.0 - _OUTERMOST:
            raise DataError(
                f"the probability must lie between {_OUTERMOST:g} and 1 - {_OUTERMOST:g}, not {probability!r}"
            )
        # With ln Q as argument, and with the quantile of the standard normal distribution at the probability as value,
        # the distribution is nearly a straight line, exactly one for a log-normal variable: with mean m and variance V
        # it has the logarithmic deviation √ln(1 + V/m²) and the median m exp(-½ spread²). The search begins at its
        # quantile and follows its line, so that few evaluations are needed; each costs an integral for each part.
        spread = math.sqrt(math.log1p(max(self.variance / self.mean**2, _LEAST_SPREAD**2)))
        wanted = float(ndtri(probability))

        @cache
        def missed_by(logarithm: float) -> float:
            reached = min(max(self.at_most(math.exp(logarithm)), _LEAST_PROBABILITY), 1.0 - _ROUNDING)
            return float(ndtri(reached)) - wanted

        start = math.log(self.mean) + spread * (wanted - 0.5 * spread)
        missed = missed_by(start)
        if missed == 0.0:
            return math.exp(start)
        # Some more than the line says, so that the quantile lies between; the steps grow until it does.
        step = -spread * (_BEYOND * missed + math.copysign(_SHORTEST, missed))
        end = start + step
        for _ in range(_MOST_STEPS):
            if missed_by(end) * missed <= 0.0:
                break
            start, step = end, 2.0 * step
            end = start + step
        else:
            raise DataError(f"the distribution has no quantile at the probability {probability!r}")
        return math.exp(root_between(missed_by, min(start, end), max(start, end), min(_TOLERANCE, _OF_SPREAD * spread)))


@dataclass(frozen=True, eq=False)
class VolumetricDistribution:
    """Distribution of the mean square deviation over the workspace, in mm².

    `raw` is the distribution for the whole deviation; `aligned` is the distribution after the best-fitting rigid motion
    has been removed.
    """

    raw: QuadraticDistribution | QuadraticMixture
    aligned: QuadraticDistribution | QuadraticMixture

    @property
    def expected(self) -> VolumetricRms:
        """Root of the expected mean square deviation in mm, raw and aligned."""
        return VolumetricRms(math.sqrt(self.raw.mean), math.sqrt(self.aligned.mean))

    @property
    def median(self) -> VolumetricRms:
        return self.quantile(0.5)

    def quantile(self, probability: float) -> VolumetricRms:
        """Return the volumetric error (an rms in mm) that is not exceeded with the given probability."""
        raw, aligned = (math.sqrt(max(form.quantile(probability), 0.0)) for form in (self.raw, self.aligned))
        return VolumetricRms(raw, aligned)

    def limits(self, coverage: float = 0.95) -> tuple[VolumetricRms, VolumetricRms]:
        """Return the lower and the upper limit of the equal-tailed interval for the volumetric error, in mm, that has
        the given coverage.
        """
        outside = 0.5 * (1.0 - coverage)
        return self.quantile(outside), self.quantile(1.0 - outside)


@dataclass(frozen=True, eq=False)
class VolumetricDistributions:
    """Distributions of the volumetric error without compensation (`ve`) and with compensation (`vce`).

    `vce` applies to the residual field, which contains the deviations of the machine minus those that the compensation
    model gives.
    """

    ve: VolumetricDistribution
    vce: VolumetricDistribution


@dataclass(frozen=True, eq=False)
class AlignedDistributions:
    """Distributions of the mean square deviation over the workspace in mm², after the best-fitting rigid motion has
    been removed: without compensation (`ve`) and with compensation (`vce`). `resolved_ve` and `resolved_vce` do not
    count the part of the misfit whose wavelength is too short for the misfit modes.
    """

    ve: QuadraticMixture
    vce: QuadraticMixture
    resolved_ve: QuadraticMixture
    resolved_vce: QuadraticMixture


def aligned_distributions(estimate: Estimate, points: ArrayLike, tool_offset: ArrayLike) -> AlignedDistributions:
    """Return the distributions that `volumetric_distributions` returns, only those after the best-fitting rigid motion
    has been removed, with and without the unresolved misfit. That takes half the time.

    Raises DataError if a covariance is invalid or zero.
    """
    grid, offset = as_points(points, "points"), as_vector(tool_offset, 3, "tool offset")
    form, written, likely = field_forms(estimate, grid, offset)[1], _written(estimate), mixture_components(estimate)
    ve, vce = zip(*(_both(form, one, written) for one in likely), strict=True)
    # The unresolved misfit is a constant of each part.
    absent = [3.0 * one.unresolved_mm2 for one in likely]
    resolved_ve, resolved_vce = (
        tuple(replace(part, least=part.least - constant) for part, constant in zip(parts, absent, strict=True))
        for parts in (ve, vce)
    )
    return AlignedDistributions(*map(QuadraticMixture, (ve, vce, resolved_ve, resolved_vce)))


def volumetric_distributions(estimate: Estimate, points: ArrayLike, tool_offset: ArrayLike) -> VolumetricDistributions:
    """Return the distributions of the volumetric error with and without compensation, given `estimate`.

    The error is taken over the axis positions `points`, shape (n, 3), in mm. The distributions are averaged over all
    sets of scales that are compatible with the measurements. Raises DataError if a covariance is invalid or zero.
    """
    grid, offset = as_points(points, "points"), as_vector(tool_offset, 3, "tool offset")
    written, likely = _written(estimate), mixture_components(estimate)
    parts = [[_both(form, one, written) for one in likely] for form in field_forms(estimate, grid, offset)]
    ve, vce = (
        VolumetricDistribution(*(QuadraticMixture(tuple(pair[which] for pair in pairs)) for pairs in parts))
        for which in (0, 1)
    )
    return VolumetricDistributions(ve, vce)


def _both(form: Array, one: MixtureComponent, written: Array) -> tuple[QuadraticDistribution, ...]:
    """Return the distributions of the mean square before and after compensation by the parameters `written`."""
    # Compensation subtracts the written parameters from every machine: it moves the mean and leaves the covariance. The
    # unresolved misfit adds its variance in three directions.
    means = (one.mean, one.mean - written)
    return QuadraticDistribution.about(form, np.zeros(len(written)), 3.0 * one.unresolved_mm2, means, one.factor)


def _written(estimate: Estimate) -> Array:
    """Return the parameters of the estimate as compensation, followed by a zero for each coefficient of the misfit."""
    modes = 0 if estimate.misfit is None else estimate.misfit.modes.size
    return np.concatenate((estimate.parameters, np.zeros(modes)))
