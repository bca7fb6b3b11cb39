"""The field that compensation leaves, true field less compensation model, as one quadratic form.

True machines may have other Legendre orders and cross-effect terms than the model identified. Both are embedded in the
model that has the parameters of either, so that what is left is linear in one parameter vector and the grid is
evaluated once for a model, a reality and a tool.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from twin.arrays import Array
from twin.deflection import DeflectionGrid
from twin.error_model import CROSS_TERMS, ERROR_MOTIONS, ErrorModel
from twin.errors import ModelError
from twin.reality import Reality
from twin.volumetric import QuadraticForm, Volumetric

Places = np.ndarray[Any, np.dtype[np.int64]]


@dataclass(frozen=True, eq=False)
class FieldForm:
    """`form`: of the joint model (u parameters) with the deflection as its fixed field; `own` (p,), `true` (t,): where
    the parameters of the identified model and those of the true family stand in it."""

    model: ErrorModel
    reality: Reality
    form: QuadraticForm
    own: Places
    true: Places

    @classmethod
    def build(cls, model: ErrorModel, reality: Reality, grid: ArrayLike, tool_offset: ArrayLike) -> FieldForm:
        """For grid positions (n, 3) and tool offset (3,) mm. ModelError where the two models do not belong together."""
        truth = reality.family.model
        joint = joint_model(model, truth)
        form = QuadraticForm.build(joint, grid, tool_offset)
        if reality.deflection is not None:
            form = form.with_field(deflected(reality.deflection, form.axis_positions))
        return cls(model, reality, form, _places(model, joint), _places(truth, joint))

    @property
    def size(self) -> int:
        """Parameters of the joint model."""
        return self.form.model.size

    @property
    def beyond(self) -> np.ndarray[Any, np.dtype[np.bool_]]:
        """(t,) which parameters of the true family the identified model does not have."""
        return ~np.isin(self.true, self.own)

    def mean_square(self, moments: Array) -> tuple[float, float]:
        """Mean square (raw, aligned) in mm² of a field whose parameters have these second moments (u, u)."""
        return float(np.vdot(self.form.raw, moments)), float(np.vdot(self.form.aligned, moments))

    def fixed_square(self, parameters: Array) -> tuple[float, float]:
        """Mean square (raw, aligned) in mm² of the deflection plus the field of fixed parameters (u,)."""
        one = self.form.value(parameters)
        return one.raw_mm**2, one.aligned_mm**2

    def before(self) -> Volumetric:
        """Root of the expected mean square of the true machines' deviation."""
        moments = np.zeros(self.size)
        moments[self.true] = self.reality.family.prior_standard_deviation**2
        return self.form.expected(np.diag(moments))


def joint_model(one: ErrorModel, other: ErrorModel) -> ErrorModel:
    """The smallest model with all parameters of both. ModelError for different chains or ranges."""
    if one.chain != other.chain or one.ranges_mm != other.ranges_mm:
        raise ModelError(
            "the true machines have another chain or other axis ranges than the model",
            hint="take both from one machine file",
        )
    orders = {error: max(one.orders[error], other.orders[error]) for error in ERROR_MOTIONS}
    terms = tuple(term for term in CROSS_TERMS if term in one.cross_effect or term in other.cross_effect)
    return ErrorModel(one.chain, one.ranges_mm, orders, terms)


def deflected(deflection: DeflectionGrid, axis_positions: Array) -> Array:
    """Deflection (n, 3) mm; a position that lies outside the grid has that of the border, as a true machine's does."""
    lower, upper = (np.array([nodes[end] for nodes in deflection.nodes]) for end in (0, -1))
    return deflection.at(np.clip(axis_positions, lower, upper))


def _places(part: ErrorModel, whole: ErrorModel) -> Places:
    return np.array([whole.index(name) for name in part.names], dtype=np.int64)
