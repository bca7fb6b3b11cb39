"""Estimated volumetric error (VE) of the machine without compensation, and predicted volumetric compensated error
(VCE), the volumetric error that remains with compensation."""

from __future__ import annotations

import numpy as np

from agent.results.facts import Quantity, VolumetricSummary
from twin.arrays import Array
from twin.identification import Estimate
from twin.identification.predicted import expected_vce, field_forms
from twin.machine.volumetric import QuadraticForm, evaluation_grid
from twin.uncertainty.volumetric_limits import limits_of_form
from twin.units import UM_PER_MM


def volumetric_summary(
    estimate: Estimate, tool_offset: Array, forms: tuple[Array, Array] | None = None
) -> VolumetricSummary:
    """Return the estimated volumetric error (VE) of the machine without compensation and the volumetric compensated
    error (VCE) expected with compensation, each with its 95 % limits.

    Both are computed over the standard grid of the workspace, in µm, after removal of the best-fitting rigid motion.
    `forms` are the two quadratic forms of the error field over this grid that `field_forms` returns; they are computed
    if they are None.
    """
    grid = evaluation_grid(estimate.model.ranges_mm)
    form = QuadraticForm.build(estimate.model, grid, tool_offset)
    if forms is None:
        forms = field_forms(estimate, grid, tool_offset)
    limits = limits_of_form(estimate, forms[1])
    table_ve_mm = form.value(estimate.parameters).aligned_mm
    return VolumetricSummary(
        before_aligned=Quantity(limits.expected_ve_um, _uncertainty_um(table_ve_mm, form, estimate), limits.ve_um),
        after_aligned=_expected(expected_vce(estimate, forms).aligned_mm, form.aligned, estimate, limits.vce_um),
        table_ve_um=UM_PER_MM * table_ve_mm,
    )


def _uncertainty_um(value_mm: float, form: QuadraticForm, estimate: Estimate) -> float:
    """Return the standard uncertainty u in µm of the VE `value_mm` of the estimated parameters.

    If the parameters are E, their covariance is P and the matrix of `form` is Q, the VE is v = sqrt(E'QE). To first
    order, u² = E'Q P Q E / v².
    """
    gradient = form.aligned @ estimate.parameters / max(value_mm, 1e-12)
    variance = float(gradient @ estimate.covariance @ gradient)
    return UM_PER_MM * float(np.sqrt(max(variance, 0.0)))


def _expected(value_mm: float, form: Array, estimate: Estimate, limits_um: tuple[float, float]) -> Quantity:
    """Return the expected VCE and, as its uncertainty, the standard deviation of the VCE of one machine, in µm.

    If the parameter errors e are normally distributed with covariance P, and the matrix `form` is Q, then VCE² = e'Qe
    has the variance 2 trace(QPQP).
    """
    product = form @ estimate.covariance
    variance = 2.0 * float(np.einsum("ij,ji->", product, product))
    uncertainty_mm = float(np.sqrt(max(variance, 0.0))) / (2.0 * max(value_mm, 1e-12))
    return Quantity(UM_PER_MM * value_mm, UM_PER_MM * uncertainty_mm, limits_um)
