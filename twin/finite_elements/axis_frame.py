"""Frame of a finite element model: which of its axes is which machine axis, and in which sense."""

from __future__ import annotations

import re
from dataclasses import dataclass

import numpy as np

from twin.arrays import Array
from twin.errors import DataError
from twin.machine.kinematic_chain import AXES

EXAMPLE = "X=+x,Y=-z,Z=+y"
_PART = re.compile(r"([XYZ])=([+-]?)([xyz])")
_LETTERS = "xyz"


@dataclass(frozen=True)
class AxisFrame:
    """Directions of the machine axes in a finite element model.

    `directions` (3, 3) has one row for each machine axis X, Y, Z: the unit vector of its positive direction in the
    frame of the model. A vector v of the model is `directions @ v` in machine axes.
    """

    directions: Array

    @property
    def handedness(self) -> float:
        """1 if the model is right-handed as the machine is, -1 if it is mirrored."""
        return float(np.round(np.linalg.det(self.directions)))

    def vectors(self, vectors: Array) -> Array:
        """Return displacements (n, 3) of the model in machine axes, in the same unit."""
        turned: Array = vectors @ self.directions.T
        return turned

    def rotations(self, rotations: Array) -> Array:
        """Return rotation vectors (n, 3) of the model in machine axes, in rad. They are right-handed in both frames, so
        a mirrored frame reverses them in addition."""
        turned: Array = self.handedness * self.vectors(rotations)
        return turned


IDENTITY = AxisFrame(np.eye(3))


def parse_frame(text: str, mirrored: bool = False) -> AxisFrame:
    """Return the frame stated as text, such as `X=+x,Y=-z,Z=+y`: the machine axis Y points along -z of the model.

    Raises DataError if an axis is missing or used twice, or if the frame is left-handed, unless the model is a mirror
    image (`mirrored`), in which case it must be left-handed.
    """
    directions = np.zeros((3, 3))
    parts = [part.strip() for part in text.split(",")]
    for part in parts:
        found = _PART.fullmatch(part)
        if found is None:
            raise DataError(f"'{part:.40}' is not an axis of a frame", hint=f"Write for example {EXAMPLE}")
        row = AXES.index(found[1])
        if directions[row].any():
            raise DataError(f"the machine axis {found[1]} is stated twice in '{text:.60}'")
        directions[row, _LETTERS.index(found[3])] = -1.0 if found[2] == "-" else 1.0
    for row, axis in enumerate(AXES):
        if not directions[row].any():
            raise DataError(f"the machine axis {axis} is missing in '{text:.60}'", hint=f"Write for example {EXAMPLE}")
    for column, letter in enumerate(_LETTERS):
        if not directions[:, column].any():
            raise DataError(f"the model axis {letter} is used by no machine axis, another one by two")
    frame = AxisFrame(directions)
    if frame.handedness < 0.0 and not mirrored:
        raise DataError(
            f"the frame '{text:.60}' is left-handed, so the model would be a mirror image of the machine",
            hint="Check the signs; if the model really is mirrored, add --mirrored",
        )
    if frame.handedness > 0.0 and mirrored:
        raise DataError(
            f"the frame '{text:.60}' is right-handed, so the model is not a mirror image of the machine",
            hint="Leave out --mirrored, or check the signs",
        )
    return frame
