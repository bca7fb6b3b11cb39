"""Drift of the machine's error field during the measurement, in the form that an identification needs. It is modelled
by changes of low-order errors and of the tip position, in proportion to a few thermal regressors.

A thermal regressor is a temperature change in K that is zero at the start of the measurement. The drift field is the
sum `field = Σ regressor · form · amplitude`. Each form is an error field per kelvin. Its amplitude is an unknown with a
unit-normal prior, because the form already contains the prior standard deviation per kelvin. A temperature model says
which forms change with which regressors.

The prior of the machine (a family or an earlier estimate) refers to the state at the start. The estimate usually refers
to a later state, most often the last one. Its parameters are the parameters at the start plus the drift until the later
state, and their covariance includes the uncertainty of the drift.

A rigid motion of the artefact or of the whole machine between two positions is absorbed by the estimated poses of the
artefact. The drift of the tip is therefore observed only within a position.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from twin.arrays import Array
from twin.errors import DataError
from twin.machine.kinematic_chain import AXES

Indices = np.ndarray[Any, np.dtype[np.int64]]


@dataclass(frozen=True)
class DriftPrior:
    """Prior standard deviations of the drift per kelvin.

    `strain_per_k` (1/K) applies to scale errors and is multiplied by the full temperature rise. `bending_per_k` applies
    to angles (in rad/K) and to the bows of straightness errors (as a fraction of half the travel, in 1/K). It is
    multiplied by the difference of two temperatures. `tip_mm_per_k` (mm/K) applies to the position of the tip.
    """

    strain_per_k: float = 12e-6
    bending_per_k: float = 0.7e-6
    tip_mm_per_k: float = 0.03

    def __post_init__(self) -> None:
        for name in ("strain_per_k", "bending_per_k", "tip_mm_per_k"):
            if not getattr(self, name) > 0.0:
                raise DataError(f"{name} must be positive, not {getattr(self, name)}")


@dataclass(frozen=True, eq=False)
class MachineDrift:
    """Drift unknowns of a machine.

    The f + 3 forms are the error fields of f parameters of the machine and of the three coordinates of the tip.
    `parameter_indices` contains the indices of the parameters, and `names` their names. `deviations` (f + 3,) contains
    the prior standard deviations of all forms in mm/K or rad/K. Each unknown is the amplitude of one form in proportion
    to one regressor: `form` (size,) and `regressor` (size,) contain their indices.
    """

    names: tuple[str, ...]
    parameter_indices: tuple[int, ...]
    deviations: Array
    form: Indices
    regressor: Indices

    @property
    def size(self) -> int:
        return len(self.form)

    def columns(self, basis: Array, regressors: Array) -> Array:
        """Return the columns (n, 3, size) of the design matrix in mm per unit of the `size` drift unknowns, for n
        measured balls (rows).

        `basis` (n, 3, p) contains the derivative of the deviation with respect to the p model parameters at the n rows.
        `regressors` (n, w) contains the w thermal regressors of the rows in K.
        """
        forms = np.empty((len(basis), 3, len(self.deviations)))
        forms[:, :, :-3] = basis[:, :, self.parameter_indices] * self.deviations[:-3]
        # A shift of the tip is the same everywhere.
        forms[:, :, -3:] = self.deviations[-3:] * np.eye(3)
        return np.asarray(regressors.take(self.regressor, axis=1)[:, None, :] * forms.take(self.form, axis=2))

    def change_matrix(self, regressors: Array) -> Array:
        """Return the matrix (f + 3, size) that, multiplied by the `size` drift unknowns, gives the changes of the f
        drifting parameters and of the three tip coordinates since the start of the measurement. `regressors` (w,)
        contains the values in K of the w thermal regressors for which the changes are computed; at the start all are
        zero."""
        matrix = np.zeros((len(self.deviations), self.size))
        matrix[self.form, np.arange(self.size)] = regressors[self.regressor] * self.deviations[self.form]
        return matrix

    def change(self, z: Array, regressors: Array) -> Array:
        """Return the changes (f + 3,), since the start of the measurement, of the f drifting parameters in mm or rad,
        followed by the changes of the three tip coordinates in mm.

        `z` (size,) contains the drift unknowns, and `regressors` (w,) contains the values in K of the w thermal
        regressors for which the changes are computed.
        """
        return np.asarray(self.change_matrix(regressors) @ z)


@dataclass(frozen=True, eq=False)
class DriftEstimate:
    """Estimated drift of a machine: the values `z` (size,) of the unknowns of `drift`, with their covariance (size,
    size)."""

    drift: MachineDrift
    z: Array
    covariance: Array

    def deviations(self, basis: Array, regressors: Array) -> Array:
        """Return the deviations (n, 3) in mm at n points that the drift adds while the thermal regressors change by
        `regressors` (n, w) in K. `basis` (n, 3, p) contains the derivative of the deviation with respect to the p model
        parameters at the points."""
        return np.asarray(self.drift.columns(basis, regressors) @ self.z)

    def change(self, regressors: Array) -> dict[str, tuple[float, float]]:
        """Return the change, since the start of the measurement, of each drifting parameter and tip coordinate with its
        standard uncertainty, both in mm or rad. The change is computed for the values `regressors` (w,) of the thermal
        regressors in K, which are zero at the start.

        The keys are names such as ``EXX[1]`` and ``tip X``.
        """
        values = self.drift.change(self.z, regressors)
        matrix = self.drift.change_matrix(regressors)
        # Standard deviations from the diagonal of M C Mᵀ, which rounding can make slightly negative.
        doubts = np.sqrt(np.maximum(np.einsum("fi,ij,fj->f", matrix, self.covariance, matrix), 0.0))
        names = (*self.drift.names, *(f"tip {axis}" for axis in AXES))
        return dict(zip(names, zip(values.tolist(), doubts.tolist(), strict=True), strict=True))
