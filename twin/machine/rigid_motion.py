"""Displacement fields of small rigid motions.

Measurements of a free artefact (one whose pose is unknown) cannot observe these motions, and they are not counted as
machine errors.
"""

from __future__ import annotations

import numpy as np

from twin.arrays import Array


def rigid_fields(points: Array, middle: Array, size_mm: float) -> Array:
    """Return six rigid motion fields (n, 3, 6) at points (n, 3) mm: three translations, three rotations.

    The rotations are about `middle` (3,) and are scaled so that the displacement at the distance `size_mm` is 1.
    """
    x, y, z = ((points - middle) / size_mm).T
    fields = np.zeros((len(points), 3, 6))
    fields[:, [0, 1, 2], [0, 1, 2]] = 1.0
    fields[:, 1, 3], fields[:, 2, 3] = -z, y
    fields[:, 0, 4], fields[:, 2, 4] = z, -x
    fields[:, 0, 5], fields[:, 1, 5] = -y, x
    return fields
