"""Posterior distribution of a machine as a mixture of Gaussians.

The identification estimates scales, which are factors on the standard deviations of noise, prior and misfit. The
mixture contains one Gaussian for each set of scales that is compatible with the measurements.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from twin.arrays import Array
from twin.identification.estimate import Estimate
from twin.uncertainty.quadratic_distribution import covariance_factor


@dataclass(frozen=True, eq=False)
class MixtureComponent:
    """One Gaussian of a mixture that describes the posterior distribution of a machine.

    `mean`, shape (m,), and `covariance`, shape (m, m), refer to a vector that contains the model parameters (mm or
    rad), followed by the coefficients of the misfit. `unresolved_mm2` is the variance per direction, in mm², of the
    part of the misfit whose wavelength is too short for the misfit modes.
    """

    mean: Array
    covariance: Array
    unresolved_mm2: float

    @cached_property
    def factor(self) -> Array:
        """Matrix L, shape (m, m), whose product L Lᵀ is `covariance`."""
        return covariance_factor(self.covariance)


def mixture_components(estimate: Estimate) -> tuple[MixtureComponent, ...]:
    """Return the Gaussians of the posterior distribution that `estimate` describes; all have equal weight.

    There is only one Gaussian if no scales were estimated.
    """
    if not estimate.alternatives:
        return (_as_stated(estimate),)
    unknowns, blocks = estimate.unknowns, estimate.unknowns.blocks
    every = np.arange(blocks.size)
    indices = np.concatenate((every[blocks.parameters], every[blocks.misfit]))
    units = np.concatenate((unknowns.scale, np.ones(len(indices) - len(unknowns.scale))))
    return tuple(
        MixtureComponent(
            mean=units * one.z[indices],
            covariance=one.covariance[np.ix_(indices, indices)] * np.multiply.outer(units, units),
            unresolved_mm2=unknowns.unresolved_mm2(one.scales),
        )
        for one in estimate.alternatives
    )


def _as_stated(estimate: Estimate) -> MixtureComponent:
    misfit = estimate.misfit
    if misfit is None:
        return MixtureComponent(estimate.parameters, estimate.covariance, 0.0)
    cross = misfit.cross_covariance
    return MixtureComponent(
        np.concatenate((estimate.parameters, misfit.coefficients)),
        np.block([[estimate.covariance, cross], [cross.T, misfit.covariance]]),
        misfit.unresolved_mm2,
    )
