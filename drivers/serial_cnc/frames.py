"""Conversion between displayed axis positions and machine coordinates.

The position sent is the displayed position plus the correction of the active compensation table. Machine coordinates
(``MPos``) are the position sent plus the axis zero (the machine coordinates that are displayed as 0). Work coordinates
are the machine coordinates minus the work offset.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from drivers.errors import CommandRejected
from drivers.roles import AxisLimits, Vector
from drivers.serial_cnc.store import BankStore

LIMIT_TOLERANCE_MM = 1e-6


class CoordinateFrames:
    """Conversion between displayed axis positions and machine coordinates.

    `axis_zero_mm` holds the machine coordinates of the point whose displayed position is 0 on every axis.
    """

    def __init__(
        self, limits: AxisLimits, axis_zero_mm: tuple[float, float, float], store: BankStore, where: Mapping[str, str]
    ) -> None:
        self.limits = limits
        self._lower, self._upper = np.array(limits.lower_mm), np.array(limits.upper_mm)
        self._zero = np.array(axis_zero_mm)
        self._store = store
        self._where = where

    def to_machine(self, displayed_mm: Vector) -> Vector:
        """Return the machine coordinates in mm, shape (3,), of the displayed axis position `displayed_mm`.

        The correction of the active compensation table is added, and the corrected position is limited to the travel of
        the axes.
        """
        # A correction near the end of travel may point beyond it, where the controller would stop with an alarm.
        sent = np.clip(self._store.correction.apply(displayed_mm), self._lower, self._upper)
        result: Vector = sent + self._zero
        return result

    def to_displayed(self, machine_mm: Vector) -> Vector:
        return self._store.correction.remove(machine_mm - self._zero)

    def require_reachable(self, target_mm: Vector, feed_mm_per_s: float | None) -> None:
        """Raise CommandRejected if a target is outside the axis travel, or if the target or the feed is invalid."""
        if not np.all(np.isfinite(target_mm)) or not (feed_mm_per_s is None or 0.0 < feed_mm_per_s < math.inf):
            raise CommandRejected(f"to {target_mm} with feed {feed_mm_per_s}: not a motion", **self._where)
        for axis, value, low, high in zip("XYZ", target_mm.tolist(), self._lower, self._upper, strict=True):
            if not low - LIMIT_TOLERANCE_MM <= value <= high + LIMIT_TOLERANCE_MM:
                raise CommandRejected(
                    f"{axis} {value:.3f} mm is outside the travel, {low:g} to {high:g} mm",
                    hint="the travel follows from $130 to $132, shifted by axis_zero_mm",
                    axis=axis,
                    **self._where,
                )
