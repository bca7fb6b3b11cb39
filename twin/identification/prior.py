"""The Gaussian prior of the parameters, and the units in which they are solved for."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from twin.arrays import Array, as_vector
from twin.error_model import ErrorModel
from twin.errors import DataError
from twin.family import Family
from twin.identification.options import Options

_SMALLEST_VARIANCE = 1e-12  # of the largest, in units of the scale


@dataclass(frozen=True, eq=False)
class ParameterPrior:
    """E = mean + scale · z. `covariance` (p, p) of z; None for the unit matrix."""

    mean: Array
    scale: Array
    covariance: Array | None = None

    def parameters(self, z: Array) -> Array:
        """(p,) in mm or rad from z (p,)."""
        return np.asarray(self.mean + self.scale * z)

    def physical_covariance(self, unit: Array) -> Array:
        """Covariance (p, p) of the parameters from that of z."""
        return np.asarray(unit * np.multiply.outer(self.scale, self.scale))

    def unit_covariance(self) -> Array:
        """(p, p) of z."""
        return np.eye(len(self.scale)) if self.covariance is None else self.covariance

    def precision(self) -> Array | None:
        """Inverse of the covariance of z, its smallest variances bounded from below; None for the unit matrix."""
        if self.covariance is None:
            return None
        values, vectors = np.linalg.eigh(self.covariance)
        bounded = np.maximum(values, _SMALLEST_VARIANCE * max(float(values[-1]), _SMALLEST_VARIANCE))
        return np.asarray((vectors / bounded) @ vectors.T)


def parameter_prior(model: ErrorModel, family: Family, options: Options) -> ParameterPrior:
    """Prior from the options, else from the family. DataError for a wrong shape or an impossible covariance."""
    mean = np.zeros(model.size)
    if options.prior_mean is not None:
        mean = as_vector(options.prior_mean, model.size, "prior mean")
    scale = options.prior_standard_deviation
    if scale is None:
        scale = family.prior_standard_deviation
    scale = as_vector(scale, model.size, "prior standard deviation")
    if (scale < 0.0).any():
        raise DataError("a prior standard deviation is negative", parameter=model.names[int(np.argmin(scale))])
    if options.prior_covariance is None:
        return ParameterPrior(mean, scale)
    return ParameterPrior(mean, scale, _in_units(np.asarray(options.prior_covariance, dtype=np.float64), scale))


def _in_units(covariance: Array, scale: Array) -> Array:
    size = len(scale)
    if covariance.shape != (size, size) or not np.isfinite(covariance).all():
        raise DataError(f"the prior covariance must be a finite ({size}, {size}) matrix")
    symmetric_factor(covariance, "the prior covariance")
    used = np.where(scale > 0.0, scale, 1.0)
    return np.asarray(covariance / np.multiply.outer(used, used))


def symmetric_factor(covariance: Array, name: str) -> Array:
    """L with L Lᵀ = covariance for a positive semi-definite matrix; DataError otherwise."""
    scale = np.sqrt(np.maximum(np.diagonal(covariance), 0.0))
    scale = np.where(scale > 0.0, scale, 1.0)
    values, vectors = np.linalg.eigh(covariance / np.multiply.outer(scale, scale))
    if values[0] < -1e-9 * max(values[-1], 1.0):
        raise DataError(f"{name} is not positive semi-definite")
    factor: Array = scale[:, None] * vectors * np.sqrt(np.maximum(values, 0.0))
    return factor
