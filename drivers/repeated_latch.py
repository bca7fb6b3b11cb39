"""Detection of a controller that reports the latched position of an earlier touch again.

An old value that lies on the path of the present touch is not noticed by its place. It is noticed by its digits: a
touch is rarely latched twice at exactly the same position, because trigger, trip delay and axes scatter.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from drivers.straight_move import distance_to_segment_mm

MOST_REPEATS = 10
"""Successive touches that may be latched exactly where the touch before was. With a resolution of 0.1 µm and a scatter
of 0.25 µm, one touch in nine is; ten in a row are less likely than 1e-9."""
COARSE_MM = 1e-3
"""Resolution in mm of a controller that reports whole steps of 1 µm or more. Its touches often agree exactly."""
_ROUNDING_MM = 1e-7


class RepeatedLatch:
    """Counter of touches that were latched exactly where the touch before was.

    A touch counts if the former latched position lies within `tolerance_mm` of its path, so that the old value would
    not be noticed otherwise. Touches that are latched at whole micrometres do not count.
    """

    def __init__(self, tolerance_mm: float) -> None:
        self._tolerance_mm = tolerance_mm
        self._former: np.ndarray | None = None
        self._repeats = 0

    def complaint(self, latched_mm: Sequence[float], start_mm: Sequence[float], target_mm: Sequence[float]) -> str:
        """Add a touch. Return what is wrong if too many touches agree exactly, else an empty text."""
        latched, former = np.array(latched_mm, dtype=float), self._former
        self._former = latched
        start, target = np.array(start_mm, dtype=float), np.array(target_mm, dtype=float)
        if former is None or distance_to_segment_mm(former, start, target) > self._tolerance_mm:
            return ""
        steps = latched / COARSE_MM
        if (latched != former).any() or float(np.abs(steps - np.rint(steps)).max()) * COARSE_MM < _ROUNDING_MM:
            self._repeats = 0
            return ""
        self._repeats += 1
        if self._repeats < MOST_REPEATS:
            return ""
        return (
            f"the last {self._repeats} repeated touches agree too well: each was latched at exactly the position of "
            "the touch before, so the controller reports an old value again"
        )
