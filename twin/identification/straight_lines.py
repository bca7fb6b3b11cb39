"""Straight artefacts: balls so close to one line that the roll about it is hardly seen.

The decision is taken once, by the certificate, and not by the measured points of each position. Noise and machine
errors of some micrometres are as large as the distances of the balls from the line, so the measured points of
neighbouring positions would give different answers.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from twin.arrays import Array
from twin.artefact.artefact import Artefact

_STRAIGHT = 1e-3  # second over first singular value of the certified centres: 0.5 mm off the line on a bar of 1.5 m

Positions = np.ndarray[Any, np.dtype[np.int64]]


@dataclass(frozen=True, eq=False)
class StraightLines:
    """Positions that hold a straight artefact.

    The mask `straight` (K,) marks these positions. `frame` (K, 3, 3) is a rotation whose first column is the direction
    of the line in the artefact's frame.
    """

    straight: np.ndarray[Any, np.dtype[np.bool_]]
    frame: Array

    @classmethod
    def of(cls, artefact: Artefact, balls: list[Positions]) -> StraightLines | None:
        """Return the straight positions, or None if there are none. `balls` contains the ball numbers of each
        position."""
        members = np.array(artefact.members or (0,) * artefact.count)
        frames = {int(member): _line_frame(artefact.balls[members == member]) for member in np.unique(members)}
        found = [frames[int(members[numbers[0]])] for numbers in balls]
        straight = np.array([frame is not None for frame in found])
        if not straight.any():
            return None
        return cls(straight, np.array([np.eye(3) if frame is None else frame for frame in found]))

    def select(self, positions: Positions) -> StraightLines:
        return StraightLines(self.straight[positions], self.frame[positions])

    def axes(self, rotation: Array) -> Array:
        """Return the axes (K, 3, 3) of the rotation increments in the workpiece frame, one axis per column.

        `rotation` (K, 3, 3) are the rotations of the poses. The first axis of a straight artefact is its line; those of
        other artefacts are the axes of the workpiece frame.
        """
        return np.where(self.straight[:, None, None], rotation @ self.frame, np.eye(3))


def _line_frame(balls: Array) -> Array | None:
    """Return the frame (3, 3) of the line on which the balls (N, 3) stand, or None if they do not stand on a line."""
    offset = balls - balls.mean(axis=0)
    weights, axes = np.linalg.svd(offset)[1:]
    if len(weights) > 1 and weights[1] > _STRAIGHT * weights[0]:
        return None
    line = axes[0] * np.sign(axes[0, np.abs(axes[0]).argmax()])
    lateral = np.cross(np.eye(3)[np.abs(line).argmin()], line)
    lateral /= np.linalg.norm(lateral)
    return np.column_stack((line, lateral, np.cross(line, lateral)))
