"""Alignment of predicted ball centres to the first two balls that were measured, which are the end balls of the
artefact.
"""

from __future__ import annotations

import numpy as np

from twin.arrays import Array
from twin.errors import DataError


def align_to_end_balls(predicted: Array, first: int, last: int, found_first: Array, found_last: Array) -> Array:
    """Return the `predicted` ball centres (N, 3) in mm, moved as a rigid body to fit the measured centres of two balls.

    The two balls are given by their indices `first` and `last`. The midpoint between them is moved to the midpoint of
    the measured centres. The line through them is then made parallel to the measured line by the smallest possible
    rotation (by the formula of Rodrigues). Two balls do not determine a rotation about this line, so that rotation
    remains as predicted. Raises DataError if the two predicted centres or the two measured centres coincide.
    """
    line, found_line = predicted[last] - predicted[first], found_last - found_first
    length, found_length = np.linalg.norm(line), np.linalg.norm(found_line)
    if length < 1e-9 or found_length < 1e-9:
        raise DataError("the two end balls coincide", hint="an alignment needs two different balls")
    rotation = _smallest_rotation(line / length, found_line / found_length)
    middle = 0.5 * (predicted[first] + predicted[last])
    found_middle = 0.5 * (found_first + found_last)
    return np.asarray((predicted - middle) @ rotation.T + found_middle)


def _smallest_rotation(source: Array, target: Array) -> Array:
    """Return the rotation (3, 3) about source × target that turns unit vector `source` into `target`.

    The two must not be opposite.
    """
    # R = 1 + K + K² / (1 + cos), K the cross-product matrix of v = source × target (Rodrigues)
    v = np.cross(source, target)
    cosine = float(source @ target)
    k = np.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])
    return np.asarray(np.eye(3) + k + k @ k / (1.0 + cosine))
