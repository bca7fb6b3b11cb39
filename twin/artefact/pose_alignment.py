"""Alignment of predicted ball centres to the first balls that were measured.

Two balls that are far apart (the end balls) determine the place and the direction of the line through them. On a bar,
all other balls are close to this line. On a plate or a frame, a third ball determines the rotation about it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from twin.arrays import Array
from twin.errors import DataError

_EQUAL_MM = 0.5
"""Distances between balls that differ by less count as equal, so that the choice does not depend on deviations of the
centres from the drawing."""

_FLAT_SHARE = 0.1
"""A third ball is needed if a ball is farther from the line of the end balls than this share of their distance."""


@dataclass(frozen=True)
class AlignmentBalls:
    """Numbers of the balls that determine the pose of the artefact.

    `ends` are the two end balls, the lower number first. `third` is the ball farthest from the line through them; it is
    None if all balls are close to this line.
    """

    ends: tuple[int, int]
    third: int | None


def choose_alignment_balls(centres: Array, balls: Sequence[int]) -> AlignmentBalls:
    """Return the alignment balls among `balls`, at least two numbers in ascending order. `centres` (N, 3) has the
    predicted centres in mm of all N balls.
    """
    points = centres[list(balls)]
    distances = np.triu(np.linalg.norm(points[:, None] - points[None], axis=2))
    # among pairs equally far apart, the first in the order of the numbers
    first, last = (int(index) for index in np.argwhere(distances > distances.max() - _EQUAL_MM)[0])
    ends = balls[first], balls[last]
    return AlignmentBalls(ends, choose_third_ball(centres, balls, ends))


def choose_third_ball(centres: Array, balls: Sequence[int], ends: tuple[int, int]) -> int | None:
    """Return the ball among `balls` that is farthest from the line through the two balls `ends`. Return None if all of
    them are close to this line. `centres` (N, 3) has the predicted centres in mm of all N balls.
    """
    points, (first, last) = centres[list(balls)], centres[list(ends)]
    length = float(np.linalg.norm(last - first))
    beside = np.linalg.norm(np.cross(points - first, (last - first) / length), axis=1)
    third = int(np.argmax(beside > beside.max() - _EQUAL_MM))
    return balls[third] if beside[third] > _FLAT_SHARE * length else None


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


def align_to_third_ball(aligned: Array, first: int, last: int, third: int, found_third: Array) -> Array:
    """Return the centres `aligned` (N, 3) in mm, which fit the end balls `first` and `last`, rotated about the line
    through these two so that the ball `third` comes closest to its measured centre.

    Raises DataError if the ball or its measured centre is on the line.
    """
    line = aligned[last] - aligned[first]
    line = line / np.linalg.norm(line)
    # parts across the line; their lengths may differ, only their directions are made to agree
    across, found_across = (
        point - aligned[first] - (point - aligned[first]) @ line * line for point in (aligned[third], found_third)
    )
    lengths = np.linalg.norm(across), np.linalg.norm(found_across)
    if min(lengths) < 1e-9:
        raise DataError("the third ball is on the line of the end balls", hint="an alignment needs a ball beside it")
    rotation = _smallest_rotation(across / lengths[0], found_across / lengths[1])
    return np.asarray((aligned - aligned[first]) @ rotation.T + aligned[first])


def _smallest_rotation(source: Array, target: Array) -> Array:
    """Return the rotation (3, 3) about source × target that turns unit vector `source` into `target`.

    The two must not be opposite.
    """
    # R = 1 + K + K² / (1 + cos), K the cross-product matrix of v = source × target (Rodrigues)
    v = np.cross(source, target)
    cosine = float(source @ target)
    k = np.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])
    return np.asarray(np.eye(3) + k + k @ k / (1.0 + cosine))
