"""Temperatures of a machine during a run, and their smoothing."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from twin.arrays import Array

SMOOTHING_HALF_WINDOW_S = 150.0


@dataclass(frozen=True, eq=False)
class MachineTemperatures:
    """Temperatures of a machine at the instants `instants_s` (n,) in s at which n balls were measured.

    `machine_c` (n,) contains the readings of the machine's thermometer in °C; it is None if a reading is missing.
    `change_k` is the temperature change of the machine in K during the run: the range of the readings, or an assumed
    value if there are none.
    """

    instants_s: Array
    machine_c: Array | None
    change_k: float

    @property
    def relative_time(self) -> Array:
        """Time since the first instant (n,), as a share of the time between the first and the last instant."""
        # At least 1 s: a single instant has no duration, and its relative time is 0.
        return np.asarray((self.instants_s - self.instants_s[self._first]) / max(float(np.ptp(self.instants_s)), 1.0))

    def since_first(self, *columns: Array) -> Array:
        """Return the w `columns` (n,) as an array (n, w) of changes since the first instant, at which all are zero."""
        values = np.stack(columns, axis=1)
        return np.asarray(values - values[self._first])

    @property
    def _first(self) -> int:
        """Index of the first instant. Instants need not be in the order of time."""
        return int(np.argmin(self.instants_s))


def smooth_readings(instants_s: Array, values: Array, half_window_s: float = SMOOTHING_HALF_WINDOW_S) -> Array:
    """Return the readings `values` (n,) of a thermometer after smoothing, which removes most of their noise. A straight
    line is fitted around each instant by weighted least squares.
    """
    away = (instants_s[None, :] - instants_s[:, None]) / half_window_s
    # Epanechnikov weights 1 - t²; the value at t = 0 of the weighted line through the neighbours
    weight = np.clip(1.0 - away**2, 0.0, None)
    total, first, second = (np.einsum("ij,ij->i", weight, away**power) for power in (0, 1, 2))
    level, slope = weight @ values, (weight * away) @ values
    spread = total * second - first**2
    # With one neighbour, or all at the same instant, no line is determined: their weighted mean remains.
    alone = spread <= 1e-9 * total**2
    safe = np.where(alone, 1.0, spread)
    return np.asarray(np.where(alone, level / total, (second * level - first * slope) / safe))
