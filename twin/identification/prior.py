"""The Gaussian prior of the parameters, and the coordinates in which it is the unit prior."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from twin.arrays import Array, as_vector
from twin.error_model import ErrorModel
from twin.errors import DataError
from twin.family import Family
from twin.identification.options import Options


@dataclass(frozen=True, eq=False)
class ParameterPrior:
    """E = mean + factor z with z ~ N(0, 1). `factor` is (p,) where the parameters are independent, else (p, p)."""

    mean: Array
    factor: Array

    def parameters(self, z: Array) -> Array:
        """(p,) from unit coordinates (p,)."""
        return self.mean + (self.factor * z if self.factor.ndim == 1 else self.factor @ z)

    def columns(self, basis: Array) -> Array:
        """Derivatives (n, 3, p) with respect to z from those with respect to E."""
        return basis * self.factor if self.factor.ndim == 1 else basis @ self.factor

    def covariance(self, unit: Array) -> Array:
        """Covariance (p, p) of the parameters from that of z."""
        if self.factor.ndim == 1:
            return unit * np.multiply.outer(self.factor, self.factor)
        return self.factor @ unit @ self.factor.T

    def cross_covariance(self, unit: Array) -> Array:
        """Covariance (p, q) of the parameters with others from that of z."""
        return self.factor[:, None] * unit if self.factor.ndim == 1 else self.factor @ unit


def parameter_prior(model: ErrorModel, family: Family, options: Options) -> ParameterPrior:
    """Prior from the options, else from the family. DataError for a wrong shape or an impossible covariance."""
    mean = np.zeros(model.size)
    if options.prior_mean is not None:
        mean = as_vector(options.prior_mean, model.size, "prior mean")
    if options.prior_covariance is not None:
        return ParameterPrior(mean, _square_root(np.asarray(options.prior_covariance), model.size))
    deviation = options.prior_standard_deviation
    if deviation is None:
        deviation = family.prior_standard_deviation
    deviation = as_vector(deviation, model.size, "prior standard deviation")
    if (deviation < 0.0).any():
        raise DataError("a prior standard deviation is negative", parameter=model.names[int(np.argmin(deviation))])
    return ParameterPrior(mean, deviation)


def _square_root(covariance: Array, size: int) -> Array:
    if covariance.shape != (size, size) or not np.isfinite(covariance).all():
        raise DataError(f"the prior covariance must be a finite ({size}, {size}) matrix")
    return symmetric_factor(covariance, "the prior covariance")


def symmetric_factor(covariance: Array, name: str) -> Array:
    """L with L Lᵀ = covariance for a positive semi-definite matrix; DataError otherwise."""
    scale = np.sqrt(np.maximum(np.diagonal(covariance), 0.0))
    scale = np.where(scale > 0.0, scale, 1.0)
    values, vectors = np.linalg.eigh(covariance / np.multiply.outer(scale, scale))
    if values[0] < -1e-9 * max(values[-1], 1.0):
        raise DataError(f"{name} is not positive semi-definite")
    factor: Array = scale[:, None] * vectors * np.sqrt(np.maximum(values, 0.0))
    return factor
