"""Array type used by `twin`, and checks of array arguments."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from twin.errors import DataError

Array = NDArray[np.float64]


def as_points(values: ArrayLike, name: str) -> Array:
    """Return `values` as a float64 array (n, 3) of n points. A single point (3,) becomes an array (1, 3).

    Raises DataError if `values` has a different shape or contains a number that is not finite. The error names the
    first bad row.
    """
    points = np.atleast_2d(np.asarray(values, dtype=np.float64))
    if points.ndim != 2 or points.shape[1] != 3:
        raise DataError(f"{name} has shape {points.shape}, expected (n, 3)")
    if not np.isfinite(points).all():
        row = int(np.flatnonzero(~np.isfinite(points).all(axis=1))[0])
        raise DataError(f"{name} contains a value that is not finite", row=row)
    return points


def as_vector(values: ArrayLike, size: int, name: str) -> Array:
    """Return `values` as a float64 vector with `size` elements. Raises DataError if the length differs or a number is
    not finite.
    """
    vector = np.asarray(values, dtype=np.float64)
    if vector.shape != (size,):
        raise DataError(f"{name} has shape {vector.shape}, expected ({size},)")
    if not np.isfinite(vector).all():
        raise DataError(f"{name} contains a value that is not finite", index=int(np.argmin(np.isfinite(vector))))
    return vector
