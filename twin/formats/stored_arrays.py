"""Arrays in JSON files: nested lists, and symmetric matrices by their lower triangle."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from twin.arrays import Array
from twin.errors import FormatError


def stored_array(values: object, shape: tuple[int, ...], source: str, key: str) -> Array:
    """Return `values` as an array of this shape. Raise FormatError, which names `source` and `key`, if they are not as
    many."""
    try:
        array = np.array(values, dtype=np.float64).reshape(shape)
    except ValueError:
        wanted = " x ".join(str(count) for count in shape)
        raise FormatError(f"{wanted} numbers are required", file=source, key=key) from None
    return array


def lower_triangle(matrix: Array) -> list[list[float]]:
    """Return the rows of the lower triangle of a symmetric `matrix` (n, n): 1 to n numbers."""
    return [row[: index + 1] for index, row in enumerate(matrix.tolist())]


def symmetric_matrix(rows: Sequence[Sequence[float]], size: int, source: str, key: str) -> Array:
    """Return the symmetric matrix (n, n) whose lower triangle is `rows`. `size` is n. Raise FormatError, which names
    `source` and `key`, if the rows have other lengths."""
    if [len(row) for row in rows] != list(range(1, size + 1)):
        message = f"the {key.rpartition('.')[2]} must have {size} rows of 1 to {size} numbers (its lower triangle)"
        raise FormatError(message, file=source, key=key)
    matrix = np.zeros((size, size))
    for index, row in enumerate(rows):
        matrix[index, : index + 1] = matrix[: index + 1, index] = row
    return matrix
