"""Anchor of a field of deviations: six constraints that determine the rigid motion which no artefact in an unknown pose
can reveal.

On a machine, the operator sets the same six quantities with every workpiece: the work offset sets the zero point, and
aligning the workpiece along a first and a second axis sets the rotation.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from twin.arrays import Array, as_vector
from twin.errors import ModelError
from twin.machine.error_model import Ranges
from twin.machine.kinematic_chain import AXES
from twin.machine.rigid_motion import rigid_fields

_LINE_POINTS = 65  # points on an anchor line; the slope of any series is exact to far below a nanometre


@dataclass(frozen=True, eq=False)
class Anchor:
    """Anchor of a compensation table, or of another field of deviations: six constraints on its values.

    The measurement of an artefact in unknown poses cannot reveal a rigid motion of the whole workspace. The six
    constraints determine this rigid motion. At the axis position `point_mm` (3,), the three components of the
    field are zero (three constraints). On the line through this point along the `primary` axis, the straight line
    fitted to the field has zero slope in both perpendicular directions (two constraints). On the line through the
    point along the `secondary` axis, the straight line fitted to the field has zero slope in the direction
    perpendicular to both axes (one constraint).
    """

    point_mm: Array
    primary: str = "X"
    secondary: str = "Y"

    def __post_init__(self) -> None:
        object.__setattr__(self, "point_mm", as_vector(self.point_mm, 3, "anchor point"))
        if self.primary not in AXES or self.secondary not in AXES or self.primary == self.secondary:
            raise ModelError(
                f"an anchor needs two different axes, not '{self.primary}' and '{self.secondary}'",
                hint="for example primary X, secondary Y",
            )


def anchoring_motion(fields: Callable[[Array], Array], ranges_mm: Ranges, anchor: Anchor) -> Array:
    """Return the small rigid motions (6, m) that have the same six anchor quantities as m deviation fields.

    `fields` returns the deviations (n, 3, m) in mm at axis positions (n, 3). The anchor lines cover the axis ranges
    `ranges_mm`. The result contains three translations in mm and three rotations in rad about the anchor point, as in
    `rigid_fields` with a size of 1 mm.
    """
    lines = _anchor_points(ranges_mm, anchor)
    held = _constraints(fields(lines), lines, anchor)
    motions = _constraints(rigid_fields(lines, anchor.point_mm, 1.0), lines, anchor)
    # The six anchor quantities are linear in the motion, and no motion has all of them zero: six equations for six
    # unknowns.
    return np.asarray(np.linalg.solve(motions, held))


def _anchor_points(ranges_mm: Ranges, anchor: Anchor) -> Array:
    """Return the points on the two anchor lines as an array (1 + 2 m, 3) in mm: the anchor point, then m points on the
    line along the primary axis, then m points on the line along the secondary axis."""
    points = np.tile(anchor.point_mm, (1 + 2 * _LINE_POINTS, 1))
    for number, letter in enumerate((anchor.primary, anchor.secondary)):
        axis = AXES.index(letter)
        rows = slice(1 + number * _LINE_POINTS, 1 + (number + 1) * _LINE_POINTS)
        points[rows, axis] = np.linspace(*ranges_mm[axis], _LINE_POINTS)
    return points


def _constraints(fields: Array, points: Array, anchor: Anchor) -> Array:
    """Return the six quantities that the anchor constrains as an array (6, m), for m fields (n, 3, m) at the n anchor
    points."""
    first, second = AXES.index(anchor.primary), AXES.index(anchor.secondary)
    # the axis numbers 0, 1 and 2 add up to 3
    third = 3 - first - second
    primary, secondary = slice(1, 1 + _LINE_POINTS), slice(1 + _LINE_POINTS, None)
    slopes_first = _slope(points[primary, first], fields[primary])
    slopes_second = _slope(points[secondary, second], fields[secondary])
    return np.concatenate((fields[0], slopes_first[[second, third]], slopes_second[[third]]))


def _slope(along: Array, fields: Array) -> Array:
    """Return the least-squares slopes (3, m) of m fields (n, 3, m) that are given at the positions `along` (n,)."""
    centred = along - along.mean()
    return np.asarray(np.tensordot(centred, fields, axes=1) / (centred @ centred))
