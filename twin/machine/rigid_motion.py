"""Displacement fields of small rigid motions.

These motions are not counted as machine errors, because measurements of a free artefact (an artefact whose pose is
unknown) cannot reveal them.
"""

from __future__ import annotations

import numpy as np

from twin.arrays import Array


def rigid_fields(points: Array, middle: Array, size_mm: float) -> Array:
    """Return the displacement fields of six small rigid motions at n `points`, shape (n, 3) in mm.

    The result has shape (n, 3, 6): three translations along x, y and z with the displacement 1 (in any unit), then
    three rotations about axes parallel to x, y and z through the point `middle`, shape (3,). A rotation displaces a
    point at the distance `size_mm` from its axis by 1.
    """
    x, y, z = ((points - middle) / size_mm).T
    fields = np.zeros((len(points), 3, 6))
    fields[:, [0, 1, 2], [0, 1, 2]] = 1.0
    fields[:, 1, 3], fields[:, 2, 3] = -z, y
    fields[:, 0, 4], fields[:, 2, 4] = z, -x
    fields[:, 0, 5], fields[:, 1, 5] = -y, x
    return fields
