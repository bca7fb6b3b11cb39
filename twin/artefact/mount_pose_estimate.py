"""How a mount really stands: a small rigid motion learned from the balls found so far."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from twin.arrays import Array
from twin.machine.rigid_motion import rigid_fields

_SIZE_MM = 1000.0
# Relative to the best seen motion; a turn about a straight bar's own axis stays at zero until something shows it.
_SEEN = 1e-2


@dataclass(frozen=True, eq=False)
class MountPoseEstimate:
    """`expected` and `found` (n, 3) mm: where balls were thought to be from the nominal place, and where they were.

    Before anything was found the mount stands where it is said to stand.
    """

    expected: Array
    found: Array

    @classmethod
    def nominal(cls) -> MountPoseEstimate:
        return cls(np.zeros((0, 3)), np.zeros((0, 3)))

    def with_found_balls(self, expected: Array, found: Array) -> MountPoseEstimate:
        """With further balls (n, 3); earlier ones keep their weight."""
        return MountPoseEstimate(np.concatenate((self.expected, expected)), np.concatenate((self.found, found)))

    def transform(self, points: Array) -> Array:
        """Nominal points (m, 3) where they must be, as the mount stands: best small rigid motion, least squares,
        smallest motion where the balls leave one open."""
        if len(self.expected) == 0:
            return points
        middle = self.expected.mean(axis=0)
        fields = rigid_fields(self.expected, middle, _SIZE_MM).reshape(-1, 6)
        motion = np.linalg.lstsq(fields, (self.found - self.expected).reshape(-1), rcond=_SEEN)[0]
        return np.asarray(points + rigid_fields(points, middle, _SIZE_MM) @ motion)
