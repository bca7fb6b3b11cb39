"""Tolerances of the place of an artefact, on a mount or placed by hand.

Settings, collision checks and measurement share these values.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

MOUNT_ALLOWANCE_MM = 3.0
"""Allowance at the ends of travel for the deviation of a mount from its nominal location."""


@dataclass(frozen=True)
class PlacementTolerance:
    """Largest deviation of the artefact from the position in which it is to be placed: `distance_mm` is the
    displacement of any ball by a shift of the whole artefact, and `angle_deg` is its rotation."""

    distance_mm: float
    angle_deg: float

    def displacement_mm(self, radius_mm: float) -> float:
        """Return the largest displacement in mm of a ball at the distance `radius_mm` from the centre of rotation."""
        return self.distance_mm + math.radians(self.angle_deg) * radius_mm
