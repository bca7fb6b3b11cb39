"""Posterior of one estimate as the prior of the next estimate (fusion of nights).

Without process noise, the machine, the artefact and the misfit are assumed to be the same in both nights. The prior of
the second night is therefore the joint Gaussian posterior of all unknowns that the two nights share. The result is
then, up to rounding, the same as from one fit of the measurements of both nights. With process noise, the machine is
assumed to change between the nights by a random walk: of its parameters by stated amounts, and of its misfit in the
same proportion. A factor on these amounts is learned from the nights and carried on with the estimate, and so is the
knowledge about errors that drift in one direction (module `twin.identification.drift_trend`).
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg.lapack import dpotrf

from twin.arrays import Array, as_vector
from twin.errors import DataError
from twin.identification.drift_trend import DriftRates, DriftStart, DriftTrend
from twin.identification.normal import JointPrior
from twin.identification.scales import Scales
from twin.identification.unknowns import Indices, Unknowns
from twin.machine.machine_population import Family
from twin.machine.volumetric import QuadraticForm, evaluation_grid

_ASYMMETRY = 1e-9  # of the largest entry
_WALK_GRID = (20, 10, 10)

UNKNOWN_LOG_DEVIATION = math.log(3.0)
"""Standard deviation of the logarithm of a drift factor before any night has been measured."""


@dataclass(frozen=True)
class DriftFactor:
    """Factor by which a machine drifts more (above 1) or less (below 1) than the stated process noise.

    The factor has a log-normal distribution with the median `value`. `log_deviation` is the standard deviation of its
    natural logarithm. The defaults are those before any night: a stated process noise is trusted to a factor of 3.
    """

    value: float = 1.0
    log_deviation: float = UNKNOWN_LOG_DEVIATION


@dataclass(frozen=True, eq=False)
class CarriedOverPrior:
    """Prior of the P unknowns z, carried over from an earlier estimate.

    `mean` (P,) and `covariance` (P, P) of z are in the units of `unknowns`. `scales` are the factors on the standard
    deviations of noise, prior and misfit in the earlier estimate. `drift_factor` is the factor on the process noise, as
    learned from the nights until then. `degrees_of_freedom` are those from which the scale of the noise was estimated.
    `trend` is the knowledge about errors that drift in one direction. `joined_readings` are the checksums of readings
    of other instruments that are part of the earlier estimate.
    Raises DataError, which names the unknown, if the covariance is singular or invalid.
    """

    unknowns: Unknowns
    mean: Array
    covariance: Array
    scales: Scales
    drift_factor: DriftFactor = DriftFactor()
    degrees_of_freedom: float = math.inf
    trend: DriftTrend = field(default_factory=DriftTrend)
    joined_readings: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        size = self.unknowns.blocks.size
        object.__setattr__(self, "mean", as_vector(self.mean, size, "mean carried over"))
        covariance = np.asarray(self.covariance, dtype=np.float64)
        if covariance.shape != (size, size) or not np.isfinite(covariance).all():
            raise DataError(f"the carried-over covariance must be a finite ({size}, {size}) matrix")
        wrong = np.abs(covariance - covariance.T).max(axis=1) > _ASYMMETRY * np.abs(covariance).max()
        if wrong.any():
            row = int(np.argmax(wrong))
            raise DataError("the carried-over covariance is not symmetric", row=row, unknown=self.unknowns.name(row))
        failed = dpotrf(covariance, lower=1)[1]
        if failed:
            raise DataError(
                "the carried-over covariance is singular or indefinite",
                hint="every unknown of an estimate has some uncertainty: use its file exactly as it was written",
                row=int(failed) - 1,
                unknown=self.unknowns.name(int(failed) - 1),
            )
        object.__setattr__(self, "covariance", covariance)

    def for_another_thermometer(self) -> CarriedOverPrior:
        """Return the prior without the knowledge of the error of the artefact's thermometer, for measurements whose
        temperatures were read by a different thermometer or not at all."""
        blocks, artefact = self.unknowns.blocks, self.unknowns.artefact
        if "thermometer" not in artefact.strain_names:
            return self
        left_out = blocks.strain.start + artefact.strain_names.index("thermometer")
        unknowns = replace(self.unknowns, artefact=replace(artefact, thermometer_standard_uncertainty_k=0.0))
        covariance = np.delete(np.delete(self.covariance, left_out, axis=0), left_out, axis=1)
        mean, trend = np.delete(self.mean, left_out), self.trend.without(left_out)
        return replace(self, unknowns=unknowns, mean=mean, covariance=covariance, trend=trend)

    def after(self, process_noise: ArrayLike, nights: float = 1.0) -> CarriedOverPrior:
        """Return the prior `nights` nights later, moved by the rates of errors that drift in one direction, and with
        the random walk of parameters and misfit added. The knowledge about the drift is left out of it.

        `process_noise` (p,) contains the stated standard deviation of the walk of each of the p parameters per night,
        in mm or rad. All standard deviations of the walk are multiplied by the drift factor.
        """
        moved = self.drifted(nights)
        covariance = moved.covariance.copy()
        np.einsum("ii->i", covariance)[:] += self.drift_factor.value**2 * self.walk_variances(process_noise, nights)
        return replace(moved, covariance=covariance, trend=DriftTrend())

    def drifted(self, nights: float) -> CarriedOverPrior:
        """Return the prior `nights` nights later, moved by the rates of errors that drift in one direction, with the
        walk of these errors about their drift, but without the random walk of the machine."""
        rates = self.trend.rates
        if rates is None:
            return self
        mean, covariance = self.mean.copy(), self.covariance.copy()
        mean[rates.columns] += nights * rates.mean
        covariance[:, rates.columns] += nights * rates.cross
        covariance[rates.columns] += nights * rates.cross.T
        covariance[np.ix_(rates.columns, rates.columns)] += nights**2 * rates.covariance
        covariance[rates.columns, rates.columns] += nights * rates.walk_variances
        return replace(self, mean=mean, covariance=covariance, trend=replace(self.trend, rates=rates.predicted(nights)))

    def with_rates(self, start: DriftStart, rates: DriftRates) -> CarriedOverPrior:
        """Return the prior if the errors with these `rates` drift since `start`, which it did not know of. The sums of
        the trend, which refer to a machine without this drift, are left out of it."""
        effect = start.effect[:, rates.columns]
        known = self.trend.rates
        return replace(
            self,
            mean=self.mean + effect @ rates.mean,
            covariance=self.covariance + effect @ rates.covariance @ effect.T,
            trend=DriftTrend((), rates if known is None else known.joined(rates)),
        )

    def walk_variances(self, process_noise: ArrayLike, nights: float = 1.0) -> Array:
        """Return the variance (P,) that a random walk of the machine adds to each of the P unknowns in `nights` nights,
        in the units of the unknowns and for a drift factor of 1.

        `process_noise` (p,) contains the standard deviation of the walk of each of the p parameters per night, in mm or
        rad. A parameter that the prior population holds at zero stays at zero. The misfit walks in the
        same proportion as the machine: if the median parameter walks by 5 % of the standard deviation that the
        parameters of this machine have, each coefficient of the misfit walks by 5 % of the estimated standard deviation
        of its kind. Raises DataError if a process noise or the number of nights is negative.
        """
        noise = as_vector(process_noise, self.unknowns.model.size, "process noise")
        if (noise < 0.0).any():
            parameter = self.unknowns.model.names[int(np.argmin(noise))]
            raise DataError("a process noise is negative", parameter=parameter)
        if not nights >= 0.0:
            raise DataError(f"the number of nights must not be negative, not {nights}")
        scale, blocks = self.unknowns.scale, self.unknowns.blocks
        free = scale > 0.0
        walk = np.zeros(blocks.size)
        walk[blocks.parameters][free] = noise[free] / scale[free]
        share = float(np.median(walk[blocks.parameters][free])) / self.scales.motions if free.any() else 0.0
        for kind, deviation in zip(blocks.kinds, self.scales.kinds, strict=False):
            walk[kind] = share * deviation
        return np.asarray(walk**2 * nights)


def process_noise(family: Family, field_mm: float, tool_offset: ArrayLike) -> Array:
    """Return the standard deviations (p,), in mm or rad, of a random change of the p parameters of a machine. They are
    proportional to the prior standard deviations of `family`.

    The error field that the change causes has an expected rms of `field_mm` over the workspace, after the best-fitting
    rigid motion has been removed.
    """
    if not field_mm >= 0.0:
        raise DataError(f"the rms of the process noise must not be negative, not {field_mm}")
    deviation = family.prior_standard_deviation
    form = QuadraticForm.build(family.model, evaluation_grid(family.model.ranges_mm, _WALK_GRID), tool_offset)
    whole = form.expected(np.diag(deviation**2)).aligned_mm
    return np.asarray(deviation * (field_mm / whole)) if whole > 0.0 else np.zeros_like(deviation)


def joint_prior_for(unknowns: Unknowns, carried: CarriedOverPrior) -> JointPrior:
    """Return the carried-over prior, rearranged for the unknowns of the identification of another night. An unknown
    that the earlier estimate does not contain keeps its own prior."""
    there, here = shared_unknowns(carried.unknowns, unknowns)
    size = unknowns.blocks.size
    taken, precision, information_vector = np.zeros(size, dtype=bool), np.zeros((size, size)), np.zeros(size)
    # marginal posterior of the shared unknowns as precision C⁻¹ and information vector C⁻¹ m
    inverse = np.linalg.inv(carried.covariance[np.ix_(there, there)])
    inverse = 0.5 * (inverse + inverse.T)
    taken[here] = True
    precision[np.ix_(here, here)] = inverse
    information_vector[here] = inverse @ carried.mean[there]
    return JointPrior(taken, precision, information_vector)


def shared_unknowns(old: Unknowns, new: Unknowns) -> tuple[Indices, Indices]:
    """Return the indices (m,) of the unknowns that both identifications share, in the old z and in the new z."""
    pairs = list(_shared(old, new))
    there, here = (
        np.concatenate([np.arange(part.start, part.stop) for part in parts]) for parts in zip(*pairs, strict=True)
    )
    return there, here


def _shared(old: Unknowns, new: Unknowns) -> Iterator[tuple[slice, slice]]:
    """Yield pairs of slices with the same meaning. The first slice of each pair applies to the old z, and the second to
    the new z."""
    before, now = old.blocks, new.blocks
    yield before.parameters, now.parameters
    if old.artefact.certificate is new.artefact.certificate:
        yield before.certificate, now.certificate
        for index, name in enumerate(new.artefact.strain_names):
            if name in old.artefact.strain_names and (name != "thermometer" or _same_thermometer(old, new)):
                at = before.strain.start + old.artefact.strain_names.index(name)
                yield slice(at, at + 1), slice(now.strain.start + index, now.strain.start + index + 1)
        if old.artefact.sag == new.artefact.sag:
            yield before.sag, now.sag
    if old.modes is not None and old.modes is new.modes:
        yield before.misfit, now.misfit


def _same_thermometer(old: Unknowns, new: Unknowns) -> bool:
    """Return True if the thermometers of both nights have the same standard uncertainty, and thus the same error."""
    one, other = (each.artefact.thermometer_standard_uncertainty_k for each in (old, new))
    return one == other
