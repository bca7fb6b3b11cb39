"""Estimate of the actual pose of a mount, the rotary device that holds the artefact. It is a small rigid motion fitted
to the balls measured so far.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from twin.arrays import Array
from twin.machine.rigid_motion import rigid_fields

_SIZE_MM = 1000.0
# Relative to the best determined motion; rotation about a straight bar's own axis stays zero until it is observable.
_OBSERVABLE = 1e-2


@dataclass(frozen=True, eq=False)
class MountPoseEstimate:
    """Estimate of the pose of a mount from n balls measured so far.

    `expected` (n, 3) contains the centres of these balls in mm for the nominal mount location. `found` (n, 3) contains
    their measured centres in mm. If no ball has been measured, the mount is assumed to be at its nominal location.
    """

    expected: Array
    found: Array

    @classmethod
    def nominal(cls) -> MountPoseEstimate:
        return cls(np.zeros((0, 3)), np.zeros((0, 3)))

    def with_found_balls(self, expected: Array, found: Array) -> MountPoseEstimate:
        """Return a new estimate that also uses the given, newly measured balls. All balls, earlier and new, have equal
        weight.

        `expected` and `found` are arrays (n, 3) in mm with the expected and the measured centres of the new balls.
        """
        return MountPoseEstimate(np.concatenate((self.expected, expected)), np.concatenate((self.found, found)))

    def transform(self, points: Array) -> Array:
        """Return the nominal points (m, 3) in mm after the estimated small rigid motion of the mount.

        The motion is fitted to the measured balls by least squares. If the balls do not determine the motion fully, the
        smallest of the best-fitting motions is used.
        """
        if len(self.expected) == 0:
            return points
        middle = self.expected.mean(axis=0)
        fields = rigid_fields(self.expected, middle, _SIZE_MM).reshape(-1, 6)
        motion = np.linalg.lstsq(fields, (self.found - self.expected).reshape(-1), rcond=_OBSERVABLE)[0]
        return np.asarray(points + rigid_fields(points, middle, _SIZE_MM) @ motion)
