"""Estimated volumetric error (VE) of the machine without compensation, and predicted volumetric compensated error
(VCE), the volumetric error that remains with compensation."""

from __future__ import annotations

import numpy as np

from agent.results.facts import Quantity, VolumetricSummary
from twin.arrays import Array
from twin.identification import Estimate, predicted_vce
from twin.machine.volumetric import QuadraticForm, evaluation_grid


def volumetric_summary(estimate: Estimate, tool_offset: Array) -> VolumetricSummary:
    """Return the estimated volumetric error (VE) of the machine without compensation and the volumetric compensated
    error (VCE) expected with compensation.

    Both are computed over the standard grid of the workspace, in µm.
    """
    grid = evaluation_grid(estimate.model.ranges_mm)
    form = QuadraticForm.build(estimate.model, grid, tool_offset)
    before = form.value(estimate.parameters)
    after = predicted_vce(estimate, grid, tool_offset)
    return VolumetricSummary(
        before_raw=_of_estimate(before.raw_mm, form.raw, estimate),
        before_aligned=_of_estimate(before.aligned_mm, form.aligned, estimate),
        after_raw=_expected(after.raw_mm, form.raw, estimate.covariance),
        after_aligned=_expected(after.aligned_mm, form.aligned, estimate.covariance),
    )


def _of_estimate(value_mm: float, form: Array, estimate: Estimate) -> Quantity:
    """Return the VE and its standard uncertainty u in µm.

    If the parameters are E, their covariance is P and the matrix `form` is Q, the VE is v = sqrt(E'QE). To first order,
    u² = E'Q P Q E / v².
    """
    gradient = form @ estimate.parameters / max(value_mm, 1e-12)
    variance = float(gradient @ estimate.covariance @ gradient)
    return Quantity(1e3 * value_mm, 1e3 * float(np.sqrt(max(variance, 0.0))))


def _expected(value_mm: float, form: Array, covariance: Array) -> Quantity:
    """Return the expected VCE and, as its uncertainty, the standard deviation of the VCE of one machine, in µm.

    If the parameter errors e are normally distributed with covariance P, and the matrix `form` is Q, then VCE² = e'Qe
    has the variance 2 trace(QPQP).
    """
    product = form @ covariance
    variance = 2.0 * float(np.einsum("ij,ji->", product, product))
    return Quantity(1e3 * value_mm, 1e3 * float(np.sqrt(max(variance, 0.0))) / (2.0 * max(value_mm, 1e-12)))
