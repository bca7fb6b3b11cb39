"""Residual field in the coordinates of a workpiece that has been set up on the machine.

An artefact in an unknown pose does not reveal the six terms of a rigid motion of the whole workspace, and no
compensation identified from it contains them. They do no harm to a workpiece, because its set-up removes them: the work
offset sets the zero point (three terms), and aligning the workpiece along two axes sets the rotation (three terms).
This module gives the mean square of the field that remains after the set-up.

Let S be the rigid motion that best fits a field over the grid, and W the rigid motion that the set-up removes. The
field without W differs from the aligned field, which is orthogonal to all rigid motions, by the rigid motion S - W. The
mean squares therefore add up: the square in the work frame is the aligned square plus that of S - W.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from twin.arrays import Array, as_points
from twin.machine.anchor import Anchor, anchoring_motion
from twin.machine.rigid_motion import rigid_fields
from twin.uncertainty.error_budget import ErrorBudget
from twin.uncertainty.residual_field_form import FieldForm


@dataclass(frozen=True, eq=False)
class WorkFrameForm:
    """Mean square of a residual field after the set-up of a workpiece has removed its rigid motion.

    `departure`, shape (12, u + 1), contains the coefficients of the rigid motion S - W for each of the u parameters of
    `field` and, in the last column, for the deflection: six for S, then six for -W. `gram`, shape (12, 12), contains
    the mean products over the grid of the rigid motions to which these coefficients belong.
    """

    field: FieldForm
    departure: Array
    gram: Array

    @classmethod
    def aligned_by(cls, field: FieldForm, anchor: Anchor) -> WorkFrameForm:
        """Return the form for a workpiece that is zeroed at the anchor point and aligned along the two axes of
        `anchor`: the six rigid terms of the field are zero there."""
        motion = anchoring_motion(lambda at: _columns(field, at), field.model.ranges_mm, anchor)
        return cls._without(field, anchor.point_mm, motion)

    @classmethod
    def zeroed_at(cls, field: FieldForm, point_mm: ArrayLike) -> WorkFrameForm:
        """Return the form for a work offset alone: the field is zero at `point_mm`, shape (3,), and not rotated."""
        point = np.asarray(point_mm, dtype=np.float64)
        shift = np.zeros((6, field.size + 1))
        shift[:3] = _columns(field, point[None, :])[0]
        return cls._without(field, point, shift)

    @classmethod
    def fitted_at(cls, field: FieldForm, axis_positions: ArrayLike) -> WorkFrameForm:
        """Return the form for a rigid motion fitted to the field at `axis_positions`, shape (n, 3), in mm.

        It describes a measurement of balls whose places on the machine are known in advance.
        """
        points = as_points(axis_positions, "axis positions")
        middle = points.mean(axis=0)
        motions = rigid_fields(points, middle, 1e3).reshape(-1, 6)
        columns = _columns(field, points).reshape(-1, field.size + 1)
        motion = np.asarray(np.linalg.lstsq(motions, columns, rcond=1e-12)[0], dtype=np.float64)
        motion[3:] /= 1e3  # from a size of 1000 mm to the unit of `_without`
        return cls._without(field, middle, motion)

    @classmethod
    def _without(cls, field: FieldForm, middle_mm: Array, motion: Array) -> WorkFrameForm:
        """Return the form without the rigid `motion`, shape (6, u + 1), about `middle_mm`, rotations in rad."""
        grid = field.form.axis_positions
        both = np.concatenate((field.rigid_motions_at(grid), rigid_fields(grid, middle_mm, 1.0)), axis=2)
        flat = both.reshape(-1, both.shape[2])
        return cls(field, np.concatenate((field.rigid_shares, -motion)), flat.T @ flat / len(grid))

    def expected_mm(self, budget: ErrorBudget) -> float:
        """Return the root of the mean square of the field that remains after compensation, expected over machines."""
        return self._root(budget.total, budget.bias)

    def uncompensated_mm(self) -> float:
        """Return the root of the mean square of the field without compensation, expected over machines."""
        return self._root(self.field.family_moments, np.zeros(self.field.size))

    def values_mm(self, parameters: ArrayLike) -> Array:
        """Return the rms, shape (m,), of m residual fields with the given `parameters`, shape (m, u)."""
        vectors = np.asarray(parameters, dtype=np.float64)
        aligned_mm = self.field.form.values(vectors)[1]
        moved = vectors @ self.departure[:, :-1].T + self.departure[:, -1]
        return np.asarray(np.sqrt(aligned_mm**2 + np.einsum("mi,ij,mj->m", moved, self.gram, moved)))

    def _root(self, moments: Array, parameters: Array) -> float:
        random, fixed = self.departure[:, :-1], self.departure @ np.append(parameters, 1.0)
        square = self.field.mean_square(moments)[1] + self.field.fixed_square(parameters)[1]
        square += float(np.vdot(random.T @ self.gram @ random, moments)) + float(fixed @ self.gram @ fixed)
        return float(np.sqrt(max(square, 0.0)))


def _columns(field: FieldForm, axis_positions: Array) -> Array:
    """Return the basis of the joint model with the deflection as last column, shape (n, 3, u + 1)."""
    basis, deflection = field.columns_at(axis_positions)
    return np.concatenate((basis, deflection[:, :, None]), axis=2)
