"""Residual field after compensation (true field minus compensation model) as one quadratic form.

The true machines may have other Legendre orders and cross-effect terms than the identified model. The joint model has
the parameters of both, so the residual field is linear in one parameter vector. The grid needs to be evaluated only
once for each combination of model, assumptions about the true machines, and tool.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from twin.arrays import Array, as_points
from twin.errors import ModelError
from twin.machine.axis_polynomial import AxisPolynomial
from twin.machine.cross_term import CrossTerm
from twin.machine.deflection import DeflectionGrid
from twin.machine.error_model import CROSS_TERMS, ERROR_MOTIONS, ErrorModel
from twin.machine.forward_model import deviation_basis
from twin.machine.rigid_motion import rigid_fields
from twin.machine.volumetric import QuadraticForm, VolumetricRms
from twin.uncertainty.truth_assumptions import TruthAssumptions

_CHUNK = 2000  # grid points whose basis is held in memory at a time

IndexArray = np.ndarray[Any, np.dtype[np.int64]]


@dataclass(frozen=True, eq=False)
class FieldForm:
    """Quadratic form that gives the mean square of the residual field.

    The joint model has u parameters: all p parameters of the identified `model` and all t parameters of the true
    machines, which `assumptions` describe. `form` is the quadratic form of the joint model; it includes the deflection
    of the true machines as a fixed field. `model_indices`, shape (p,), and `true_indices`, shape (t,), are the indices
    of the parameters of the identified model and of the true machines in the joint model.
    """

    model: ErrorModel
    assumptions: TruthAssumptions
    form: QuadraticForm
    model_indices: IndexArray
    true_indices: IndexArray

    @classmethod
    def build(
        cls, model: ErrorModel, assumptions: TruthAssumptions, grid: ArrayLike, tool_offset: ArrayLike
    ) -> FieldForm:
        """Build the quadratic form of the residual field for a `grid` of axis positions, shape (n, 3), and a tool
        offset, shape (3,), in mm.

        Raises ModelError if `model` and the model of the true machines differ in kinematic chain or axis ranges.
        """
        truth = assumptions.family.model
        joint = joint_model(model, truth)
        form = QuadraticForm.build(joint, grid, tool_offset)
        if assumptions.deflection is not None:
            form = form.with_field(clamped_deflection(assumptions.deflection, form.axis_positions))
        return cls(model, assumptions, form, _indices(model, joint), _indices(truth, joint))

    @property
    def size(self) -> int:
        """Number of parameters of the joint model, which combines the identified and the true model."""
        return self.form.model.size

    @property
    def unmodelled(self) -> np.ndarray[Any, np.dtype[np.bool_]]:
        """Boolean mask, shape (t,), of the parameters of the true machines that the identified model does not have."""
        return ~np.isin(self.true_indices, self.model_indices)

    def mean_square(self, moments: Array) -> tuple[float, float]:
        """Return the expected mean square in mm², raw and aligned, of a residual field with random parameters.

        `moments`, shape (u, u), contains the second moments of the u parameters of the joint model. Aligned means after
        the best-fitting rigid motion has been removed. The deflection of the true machines is not included.
        """
        # E[eᵀQ e] = tr(Q M)
        return float(np.vdot(self.form.raw, moments)), float(np.vdot(self.form.aligned, moments))

    def fixed_square(self, parameters: Array) -> tuple[float, float]:
        """Return the mean square in mm², raw and aligned, of a fixed field.

        The fixed field is the deflection of the true machines plus the field of the given `parameters` of the joint
        model, shape (u,). Aligned means after the best-fitting rigid motion has been removed.
        """
        one = self.form.value(parameters)
        return one.raw_mm**2, one.aligned_mm**2

    def columns_at(self, axis_positions: ArrayLike, aligned: bool = False) -> tuple[Array, Array]:
        """Return the basis of the joint model, and the deflection of the true machines, at n axis positions.

        `axis_positions` has shape (n, 3) and is in mm. The joint model combines the identified model and the model of
        the true machines. Its basis has shape (n, 3, u) and is in mm per unit of each parameter; the deflection has
        shape (n, 3) and is in mm. If `aligned`, the rigid motion that best fits over the grid of this quadratic form is
        removed from the deflection and from the field of each parameter.
        """
        points, form = as_points(axis_positions, "axis positions"), self.form
        basis = deviation_basis(form.model, points, form.tool_offset)
        fixed = self._fixed_at(points)
        if aligned:
            motions = self.rigid_motions_at(points)
            shares = self.rigid_shares
            basis -= motions @ shares[:, :-1]
            fixed = fixed - motions @ shares[:, -1]
        return basis, fixed

    @cached_property
    def rigid_shares(self) -> Array:
        """Coefficients, shape (6, u + 1), of the rigid motions `rigid_motions_at` contained in each basis column and,
        in the last column, in the deflection. They are fitted by least squares over the grid."""
        form = self.form
        normal, shared = np.zeros((6, 6)), np.zeros((6, self.size + 1))
        for start in range(0, len(form.axis_positions), _CHUNK):
            points = form.axis_positions[start : start + _CHUNK]
            motions = self.rigid_motions_at(points).reshape(-1, 6)
            basis = deviation_basis(form.model, points, form.tool_offset).reshape(-1, self.size)
            normal += motions.T @ motions
            shared += motions.T @ np.column_stack((basis, self._fixed_at(points).reshape(-1)))
        # least squares, because a grid on one line does not determine all six motions
        return np.asarray(np.linalg.lstsq(normal, shared, rcond=1e-12)[0])

    def rigid_motions_at(self, points: Array) -> Array:
        """Return the fields, shape (n, 3, 6), of the six rigid motions about the middle of the grid, at axis positions
        `points`, shape (n, 3), in mm."""
        grid = self.form.axis_positions
        size_mm = max(float(np.ptp(grid, axis=0).max()), 1.0)
        return rigid_fields(points, grid.mean(axis=0), size_mm)

    def _fixed_at(self, points: Array) -> Array:
        deflection = self.assumptions.deflection
        return np.zeros_like(points) if deflection is None else clamped_deflection(deflection, points)

    @property
    def family_moments(self) -> Array:
        """Second moments, shape (u, u), of the joint model's parameters for the true machines before compensation."""
        variances = np.zeros(self.size)
        variances[self.true_indices] = self.assumptions.family.prior_standard_deviation**2
        return np.diag(variances)

    def uncompensated(self) -> VolumetricRms:
        """Return the root of the mean square deviation, raw and aligned, expected over the true machines.

        No compensation is active. Aligned means after the best-fitting rigid motion has been removed.
        """
        return self.form.expected(self.family_moments)


def joint_model(one: ErrorModel, other: ErrorModel) -> ErrorModel:
    """Return the smallest model that has all parameters of the models `one` and `other`.

    A term of a beam of `other` that has the name of another term of `one` gets a name of its own, CROSS[… (other)].

    Raises ModelError if the models differ in kinematic chain or axis ranges.
    """
    if one.chain != other.chain or one.ranges_mm != other.ranges_mm:
        raise ModelError(
            "the true machines and the model differ in kinematic chain or axis ranges",
            hint="take both from the same machine file",
        )
    # Series of different orders are nested, so the larger order contains the parameters of both.
    orders = {error: max(one.orders[error], other.orders[error]) for error in ERROR_MOTIONS}
    terms = tuple(term for term in CROSS_TERMS if term in one.cross_effect or term in other.cross_effect)
    return ErrorModel(one.chain, one.ranges_mm, orders, terms, _joint_structure(one.structure, other.structure))


def _joint_structure(one: Sequence[CrossTerm], other: Sequence[CrossTerm]) -> tuple[CrossTerm, ...]:
    shapes, names = {_shape(term) for term in one}, {term.name for term in one}
    added = (term for term in other if _shape(term) not in shapes)
    # the names of beams, loads and powers contain neither blanks nor brackets, so the new name is unique
    renamed = (replace(t, name=f"{t.name[:-1]} (other)]") if t.name in names else t for t in added)
    return (*one, *renamed)


def _shape(term: CrossTerm) -> tuple[str, AxisPolynomial]:
    return term.error, term.polynomial


def clamped_deflection(deflection: DeflectionGrid, axis_positions: Array) -> Array:
    """Return the deflection of a machine, shape (n, 3), at n axis positions, shape (n, 3); both are in mm.

    At a position outside the deflection grid, the value at the nearest border point is used, as in a `TrueMachine`.
    """
    lower, upper = (np.array([nodes[end] for nodes in deflection.nodes]) for end in (0, -1))
    return deflection.at(np.clip(axis_positions, lower, upper))


def _indices(part: ErrorModel, whole: ErrorModel) -> IndexArray:
    """Return the index in the joint model `whole` of each parameter of `part`. Terms of beams are found by what they
    are, since their names may differ."""
    names = {_shape(term): term.name for term in whole.structure}
    own = {term.name: names[_shape(term)] for term in part.structure}
    return np.array([whole.index(own.get(name, name)) for name in part.names], dtype=np.int64)
