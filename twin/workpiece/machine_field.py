"""Knowledge about the errors of a machine at points, as an estimate states it.

The errors are those of the posterior: the expected field includes the expected misfit, and its covariance that of the
parameters and of the misfit. Errors whose wavelength is too short for the misfit are counted as far as they were seen,
that is, by what the ball centres scatter beyond their stated noise. Differences between near points show such errors, a
volumetric error does not, which is why it counts the assumed ones too (`twin.identification.predicted`).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from twin.arrays import Array
from twin.identification.predicted import FieldKnowledge, field_columns
from twin.machine.forward_model import exact_deviation


class MachineKnowledge(FieldKnowledge, Protocol):
    """Estimate, computed or stored, of the errors of a machine."""

    @property
    def parameters(self) -> Array: ...
    @property
    def scatter_mm2(self) -> float: ...


@dataclass(frozen=True, eq=False)
class Spread:
    """Covariances (k, k) in mm² of the k numbers of a feature: without and with the errors that are not correlated
    between points."""

    smooth: Array
    whole: Array


@dataclass(frozen=True, eq=False)
class MachineField:
    """Knowledge about the errors of a machine at n points: the expected errors (3n,) in mm, their derivative `columns`
    (3n, P) with respect to the parameters and the coefficients of the misfit, the covariance (P, P) of these, and the
    variance in mm² of errors that are not correlated between points."""

    expected: Array
    columns: Array
    covariance: Array
    scatter_mm2: float

    @classmethod
    def at(cls, estimate: MachineKnowledge, axis_positions: Array, tool_offset: Array) -> MachineField:
        columns = field_columns(estimate, axis_positions, tool_offset).reshape(axis_positions.size, -1)
        expected = exact_deviation(estimate.model, axis_positions, tool_offset, estimate.parameters).reshape(-1)
        covariance, misfit = estimate.covariance, estimate.misfit
        if misfit is not None:
            cross = misfit.cross_covariance
            covariance = np.block([[covariance, cross], [cross.T, misfit.covariance]])
            expected = expected + columns[:, estimate.model.size :] @ misfit.coefficients
        return cls(expected, columns, covariance, estimate.scatter_mm2)

    def spread_of(self, operator: Array, used: NDArray[np.intp] | slice) -> Spread:
        """Return the spread of the k numbers that `operator` (k, m) makes of the m components `used`."""
        columns = operator @ self.columns[used]
        known = columns @ self.covariance @ columns.T
        return Spread(known, known + self.scatter_mm2 * operator @ operator.T)
