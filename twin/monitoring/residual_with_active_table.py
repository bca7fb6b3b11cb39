"""Expected volumetric error of a machine on which a given compensation table is active.

The expectation uses the current knowledge of the machine, which may be newer than the table: the machine may have
drifted since the table was written.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from twin.arrays import Array, as_points, as_vector
from twin.design.criterion import Criterion
from twin.identification.scales import Scales
from twin.identification.unknowns import Unknowns
from twin.machine.forward_model import deviation_basis
from twin.machine.volumetric import VolumetricRms


@dataclass(frozen=True, eq=False)
class ResidualWithTable:
    """Expected volumetric error that remains over a workspace while a compensation table is active, for one tool.

    `unknowns` defines the P unknowns z: the parameters of the error model, the coefficients of the misfit, and others.
    `form` contains the quadratic forms, shape (P, P), that give the mean square error, raw and aligned, from z.
    `unresolved_mm2` is the mean square, in mm², of the errors whose wavelength is too short for the misfit modes.
    """

    unknowns: Unknowns
    form: Criterion
    unresolved_mm2: float

    @classmethod
    def build(cls, unknowns: Unknowns, scales: Scales, grid: ArrayLike, tool_offset: ArrayLike) -> ResidualWithTable:
        """Prepare the computation of the residual error for a `grid` of axis positions, shape (n, 3), and a tool
        offset, shape (3,), in mm.

        `scales` are the factors by which the current estimate multiplies the standard deviations of noise, prior and
        misfit.
        """
        form = Criterion.build(unknowns, grid, tool_offset)
        return cls(unknowns, form, 3.0 * unknowns.unresolved_mm2(scales))

    def of(self, mean: Array, covariance: Array, written: ArrayLike) -> VolumetricRms:
        """Return the root of the expected mean square of the residual field.

        The P unknowns z of the machine have the given `mean`, shape (P,), and `covariance`, shape (P, P). `written`,
        shape (p,), contains the model parameters in mm or rad from which the table was computed.
        """
        return self._root(covariance, self.uncompensated(mean, written), self.unresolved_mm2)

    def between(self, mean: Array, other: Array) -> VolumetricRms:
        """Return the rms, over the workspace, of the difference between the deviations of two machines.

        Each machine is given by its unknowns z, shape (P,). Only the parameters of the error model in z are compared.
        All other unknowns, such as the misfit coefficients, are ignored.
        """
        step = self._parameters_only(mean - other)
        return self._root(np.zeros_like(self.form.raw), step, 0.0)

    def uncompensated(self, mean: Array, written: ArrayLike) -> Array:
        """Return the mean of the unknowns z of the machine, shape (P,), minus the parameters that the active table
        compensates.

        `mean`, shape (P,), is the mean of z. `written`, shape (p,), contains the model parameters in mm or rad from
        which the table was computed; they are converted to the units of z.
        """
        return uncompensated(self.unknowns, mean, written)

    def _parameters_only(self, step: Array) -> Array:
        own, kept = self.unknowns.blocks.parameters, np.zeros_like(step)
        kept[own] = step[own]
        return kept

    def _root(self, covariance: Array, step: Array, unresolved_mm2: float) -> VolumetricRms:
        # E[zᵀQz] = tr(Q C) + mᵀQ m for the raw and for the aligned form
        raw, aligned = (
            float(np.vdot(form, covariance)) + float(step @ form @ step) + unresolved_mm2
            for form in (self.form.raw, self.form.aligned)
        )
        return VolumetricRms(float(np.sqrt(max(raw, 0.0))), float(np.sqrt(max(aligned, 0.0))))


def uncompensated(unknowns: Unknowns, mean: Array, written: ArrayLike) -> Array:
    """Return the mean of the unknowns z of a machine, shape (P,), minus the parameters that its active table
    compensates.

    `mean`, shape (P,), is the mean of z. `written`, shape (p,), contains the model parameters in mm or rad from which
    the table was computed; they are converted to the units of z.
    """
    parameters, scale = as_vector(written, unknowns.model.size, "written parameters"), unknowns.scale
    left = mean.copy()
    # A parameter that the family holds at zero has the unit 0 and is not in z: nothing to subtract.
    left[unknowns.blocks.parameters] -= np.where(scale > 0.0, parameters / np.where(scale > 0.0, scale, 1.0), 0.0)
    return left


def residual_covariance(
    unknowns: Unknowns, scales: Scales, mean: Array, covariance: Array, points: ArrayLike, tool_offset: ArrayLike
) -> Array:
    """Return the second moments, shape (3n, 3n), of the residual field in mm².

    The residual field contains the deviations of the machine minus those that the active table compensates. It is taken
    at n axis positions `points`, shape (n, 3). Rows and columns run point by point, in the order x, y, z. `mean`, shape
    (P,), is the mean of the P unknowns z of the machine minus the parameters that the table compensates, as returned by
    `uncompensated`. `covariance`, shape (P, P), is the covariance of z.
    """
    grid, offset = as_points(points, "points"), as_vector(tool_offset, 3, "tool offset")
    blocks = unknowns.blocks
    basis = deviation_basis(unknowns.model, grid, offset)
    fields = np.zeros((*grid.shape, blocks.size))
    fields[:, :, blocks.parameters] = basis * unknowns.scale
    if unknowns.modes is not None:
        at_hand = basis if (offset == unknowns.modes.tool_offset).all() else None
        fields[:, :, blocks.misfit] = unknowns.misfit_mm * unknowns.modes.at(grid, at_hand)
    columns = fields.reshape(-1, blocks.size)
    # E[z zᵀ] = C + m mᵀ
    moments = covariance + np.multiply.outer(mean, mean)
    return np.asarray(columns @ moments @ columns.T) + unknowns.unresolved_mm2(scales) * np.eye(len(columns))
