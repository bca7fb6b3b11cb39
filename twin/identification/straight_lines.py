"""Positions of a measured set whose balls stand on one line, so that the roll about this line is hardly seen: those of
a straight artefact, or of a row of balls on another artefact."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from twin.arrays import Array
from twin.artefact.artefact import Artefact
from twin.artefact.straight_line import position_frames

Positions = np.ndarray[Any, np.dtype[np.int64]]


@dataclass(frozen=True, eq=False)
class StraightLines:
    """Positions whose measured balls stand on one line.

    The mask `straight` (K,) marks these positions. `frame` (K, 3, 3) is a rotation whose first column is the direction
    of the line in the artefact's frame.
    """

    straight: np.ndarray[Any, np.dtype[np.bool_]]
    frame: Array

    @classmethod
    def of(cls, artefact: Artefact, balls: list[Positions]) -> StraightLines | None:
        """Return the straight positions, or None if there are none. `balls` contains the ball numbers of each
        position."""
        found = position_frames(artefact, balls)
        straight = np.array([frame is not None for frame in found])
        if not straight.any():
            return None
        return cls(straight, np.array([np.eye(3) if frame is None else frame for frame in found]))

    def select(self, positions: Positions) -> StraightLines:
        return StraightLines(self.straight[positions], self.frame[positions])

    def axes(self, rotation: Array) -> Array:
        """Return the axes (K, 3, 3) of the rotation increments in the workpiece frame, one axis per column.

        `rotation` (K, 3, 3) are the rotations of the poses. The first axis of a straight position is its line; those of
        other positions are the axes of the workpiece frame.
        """
        return np.where(self.straight[:, None, None], rotation @ self.frame, np.eye(3))
