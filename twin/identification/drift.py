"""A machine whose field changes while it is measured: the low errors and the tip, each in a few ways of time.

What a warming machine does is smooth in space: scales grow, guides and columns bend, squareness opens, the tip wanders.
It is smooth in time too. What grows does so along with a thermometer; what bends, by a difference of two temperatures,
may besides have a lag of its own, for which there are further ways. Together they are a small block of unknowns,
`field = Σ course · form`, with a prior that is stated per kelvin. A row's `course` is zero where the family
(or an earlier estimate) is the prior of the machine: at the beginning. What the estimate is to hold for is a later
state, most often the last one: its parameters are those of the beginning and what has drifted until then, and what the
drift leaves open of them is in their covariance.

A rigid motion of the artefact or of the whole machine between two positions is in the poses already; the tip's drift is
seen within a position alone.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from twin.arrays import Array
from twin.errors import DataError
from twin.machine.error_model import ErrorModel, Parameter, error_motion_kind
from twin.machine.kinematic_chain import AXES

_STRAIGHTNESS_ORDER = 2  # the lowest there is: a bow
_OTHER_ORDER = 1  # of a scale and of a rotation


@dataclass(frozen=True)
class DriftPrior:
    """Standard deviations per kelvin: strain of scales (1/K); `bending` of angles (rad/K), and of bows over half the
    travel; of the tip, mm/K. What grows evenly does so by its whole expansion, what bends by a difference of two."""

    strain_per_k: float = 12e-6
    bending_per_k: float = 0.7e-6
    tip_mm_per_k: float = 0.03

    def __post_init__(self) -> None:
        for name in ("strain_per_k", "bending_per_k", "tip_mm_per_k"):
            if not getattr(self, name) > 0.0:
                raise DataError(f"{name} must be positive, not {getattr(self, name)}")


@dataclass(frozen=True, eq=False)
class MachineDrift:
    """`places` (f,) of the parameters that drift, their `deviations` (f,) mm/K or rad/K; `ways` in which they
    do: scales and tip in the first alone."""

    names: tuple[str, ...]
    parameter_indices: tuple[int, ...]
    deviations: Array
    tip_mm_per_k: float
    regressor_count: int

    @classmethod
    def of(
        cls, model: ErrorModel, prior: DriftPrior, regressor_count: int, free: np.ndarray[Any, np.dtype[np.bool_]]
    ) -> MachineDrift:
        """`free` (p,) bool: parameters that are not held at zero."""
        drifting = [(place, one) for place, one in enumerate(model.parameters) if _drifts(one) and free[place]]
        deviations = [_per_k(prior, one) * _lever_mm(model, one) for _, one in drifting]
        names, places = tuple(one.name for _, one in drifting), tuple(place for place, _ in drifting)
        return cls(names, places, np.array(deviations), prior.tip_mm_per_k, regressor_count)

    @property
    def forms(self) -> int:
        """Parameters that drift, and the three directions of the tip."""
        return len(self.parameter_indices) + 3

    @property
    def bending(self) -> list[int]:
        """Of the forms, those that drift in all ways."""
        return [number for number, name in enumerate(self.names) if not _is_scale(name)]

    @property
    def size(self) -> int:
        return self.forms + (self.regressor_count - 1) * len(self.bending)

    def columns(self, basis: Array, course: Array) -> Array:
        """(n, 3, size) mm per unit: `basis` (n, 3, p) of the model at the rows, `course` (n, ways) K."""
        forms = np.empty((len(basis), 3, self.forms))
        forms[:, :, :-3] = basis[:, :, self.parameter_indices] * self.deviations
        forms[:, :, -3:] = self.tip_mm_per_k * np.eye(3)
        bending = forms[:, :, self.bending]
        further = [course[:, way, None, None] * bending for way in range(1, self.regressor_count)]
        return np.concatenate((course[:, 0, None, None] * forms, *further), axis=2)

    def change_matrix(self, course: Array) -> Array:
        """(f + 3, size) `change` by z."""
        units = np.diag(np.append(self.deviations, np.full(3, self.tip_mm_per_k)))
        further = [share * units[:, self.bending] for share in course[1:].tolist()]
        return np.concatenate((course[0] * units, *further), axis=1)

    def change(self, z: Array, course: Array) -> Array:
        """(f + 3,) by how much parameters and tip are off, for unknowns z (size,), where the course is (ways,) K."""
        return np.asarray(self.change_matrix(course) @ z)


@dataclass(frozen=True, eq=False)
class DriftEstimate:
    """What a set says of the drift: z (size,) of `drift` with its covariance."""

    drift: MachineDrift
    z: Array
    covariance: Array

    def change(self, course: Array) -> dict[str, tuple[float, float]]:
        """By name (``EXX[1]``, ``tip X``): mm or rad by which the field is off where the course is (ways,) K, and its
        standard uncertainty."""
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
    """What makes a strain the parameter's own: half the travel for a displacement, 1 for an angle."""
    if parameter.unit == "rad":
        return 1.0
    low, high = model.ranges_mm[AXES.index(parameter.error[2])]
    return 0.5 * (high - low)
