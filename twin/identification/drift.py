"""Drift of the machine's error field during the measurement. The drift is modelled by changes of low-order errors and
of the tip position. These changes are proportional to a few thermal regressors, which are temperature changes in K.

The drift of a warming machine is smooth in space: scales expand, guides and columns bend, squareness changes, and the
tip moves. The drift is also smooth in time. Expansion follows one thermometer. Bending follows the difference of two
temperatures and may have its own time lag; further regressors describe such bending. The drift field is the sum `field
= Σ regressor · form`. Each form is a low-order error field per kelvin with an unknown amplitude. The unknown amplitudes
are a small block of unknowns with a prior stated per kelvin.

The regressors are zero at the start. The prior of the machine (a family or an earlier estimate) refers to the state at
the start. The estimate usually refers to a later state, most often the last one. Its parameters are the parameters at
the start plus the drift until the later state, and their covariance includes the uncertainty of the drift.

A rigid motion of the artefact or of the whole machine between two positions is absorbed by the estimated poses of the
artefact. The drift of the tip is therefore observed only within a position.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from twin.arrays import Array
from twin.errors import DataError
from twin.machine.error_model import ErrorModel, Parameter, error_motion_kind
from twin.machine.kinematic_chain import AXES

_STRAIGHTNESS_ORDER = 2  # lowest order of a straightness series: a bow
_OTHER_ORDER = 1  # lowest order of a scale and of a rotation


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
    """Drift unknowns of a machine: amplitudes of low-order error fields that are proportional to thermal regressors.

    `parameter_indices` contains the indices of the f parameters that drift. `deviations` (f,) contains the prior
    standard deviations of their drift in mm/K or rad/K. `regressor_count` is the number of thermal regressors. The
    scale errors of the axes and the tip position depend on the first regressor (the temperature rise) only.
    """

    names: tuple[str, ...]
    parameter_indices: tuple[int, ...]
    deviations: Array
    tip_mm_per_k: float
    regressor_count: int

    @classmethod
    def of(
        cls, model: ErrorModel, prior: DriftPrior, regressor_count: int, free: np.ndarray[Any, np.dtype[np.bool_]]
    ) -> MachineDrift:
        """Return the drift unknowns of the error model `model` with p parameters. The mask `free` (p,) marks the
        parameters that are not held at zero."""
        drifting = [(index, one) for index, one in enumerate(model.parameters) if _drifts(one) and free[index]]
        deviations = [_per_k(prior, one) * _lever_mm(model, one) for _, one in drifting]
        names, indices = tuple(one.name for _, one in drifting), tuple(index for index, _ in drifting)
        return cls(names, indices, np.array(deviations), prior.tip_mm_per_k, regressor_count)

    @property
    def forms(self) -> int:
        """Number of drift fields (error fields per kelvin): one for each drifting parameter, and three for the
        directions of the tip."""
        return len(self.parameter_indices) + 3

    @property
    def bending(self) -> list[int]:
        """Indices of the drift fields (error fields per kelvin) that depend on all thermal regressors: all fields
        except those of scale errors and of the tip."""
        return [number for number, name in enumerate(self.names) if not _is_scale(name)]

    @property
    def size(self) -> int:
        return self.forms + (self.regressor_count - 1) * len(self.bending)

    def columns(self, basis: Array, course: Array) -> Array:
        """Return the columns (n, 3, size) of the design matrix in mm per unit of the `size` drift unknowns, for n
        measured balls (rows).

        `basis` (n, 3, p) contains the derivative of the deviation with respect to the p model parameters at the n rows.
        `course` (n, w) contains the w thermal regressors of the rows in K.
        """
        forms = np.empty((len(basis), 3, self.forms))
        forms[:, :, :-3] = basis[:, :, self.parameter_indices] * self.deviations
        forms[:, :, -3:] = self.tip_mm_per_k * np.eye(3)
        bending = forms[:, :, self.bending]
        further = [course[:, way, None, None] * bending for way in range(1, self.regressor_count)]
        return np.concatenate((course[:, 0, None, None] * forms, *further), axis=2)

    def change_matrix(self, course: Array) -> Array:
        """Return the matrix (f + 3, size) that, multiplied by the `size` drift unknowns, gives the changes of the f
        drifting parameters and of the three tip coordinates since the start of the measurement. `course` (w,) contains
        the values in K of the w thermal regressors for which the changes are computed; at the start all are zero."""
        units = np.diag(np.append(self.deviations, np.full(3, self.tip_mm_per_k)))
        further = [share * units[:, self.bending] for share in course[1:].tolist()]
        return np.concatenate((course[0] * units, *further), axis=1)

    def change(self, z: Array, course: Array) -> Array:
        """Return the changes (f + 3,), since the start of the measurement, of the f drifting parameters in mm or rad,
        followed by the changes of the three tip coordinates in mm.

        `z` (size,) contains the drift unknowns, and `course` (w,) contains the values in K of the w thermal regressors
        for which the changes are computed.
        """
        return np.asarray(self.change_matrix(course) @ z)


@dataclass(frozen=True, eq=False)
class DriftEstimate:
    """Estimated drift of a machine: the values `z` (size,) of the unknowns of `drift`, with their covariance (size,
    size)."""

    drift: MachineDrift
    z: Array
    covariance: Array

    def deviations(self, basis: Array, course: Array) -> Array:
        """Return the deviations (n, 3) in mm at n points that the drift adds while the thermal regressors change by
        `course` (n, w) in K. `basis` (n, 3, p) contains the derivative of the deviation with respect to the p model
        parameters at the points."""
        return np.asarray(self.drift.columns(basis, course) @ self.z)

    def change(self, course: Array) -> dict[str, tuple[float, float]]:
        """Return the change, since the start of the measurement, of each drifting parameter and tip coordinate with its
        standard uncertainty, both in mm or rad. The change is computed for the values `course` (w,) of the thermal
        regressors in K, which are zero at the start.

        The keys are names such as ``EXX[1]`` and ``tip X``.
        """
        values = self.drift.change(self.z, course)
        matrix = self.drift.change_matrix(course)
        doubts = np.sqrt(np.maximum(np.einsum("fi,ij,fj->f", matrix, self.covariance, matrix), 0.0))
        names = (*self.drift.names, *(f"tip {axis}" for axis in AXES))
        return dict(zip(names, zip(values.tolist(), doubts.tolist(), strict=True), strict=True))


def _drifts(parameter: Parameter) -> bool:
    if parameter.kind == "squareness":
        return True
    wanted = {"positioning": _OTHER_ORDER, "rotation": _OTHER_ORDER, "straightness": _STRAIGHTNESS_ORDER}
    return wanted.get(parameter.kind) == parameter.order


def _is_scale(name: str) -> bool:
    return name.startswith("E") and error_motion_kind(name[:3]) == "positioning"


def _per_k(prior: DriftPrior, parameter: Parameter) -> float:
    return prior.strain_per_k if parameter.kind == "positioning" else prior.bending_per_k


def _lever_mm(model: ErrorModel, parameter: Parameter) -> float:
    """Return the factor that converts a strain or an angle to the parameter. The factor is half the travel in mm for a
    displacement, and 1 for an angle."""
    if parameter.unit == "rad":
        return 1.0
    low, high = model.ranges_mm[AXES.index(parameter.error[2])]
    return 0.5 * (high - low)
