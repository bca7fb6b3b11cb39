"""Thermal regressors of a run. They are time series in kelvin, and the thermal drift of the machine is modelled as
proportional to them.
"""

from __future__ import annotations

import numpy as np

from twin.arrays import Array

SECOND_REGRESSOR_SHARE = 0.4
"""Size of the second regressor (for parts with a thermal lag) as a share of the total temperature change."""
SMOOTHING_HALF_WINDOW_S = 150.0


def thermal_regressors(instants_s: Array, machine_c: Array | None, change_k: float) -> Array:
    """Return two thermal regressors in K as an array (n, 2) for n instants in s. Both are zero at the first instant.

    Let t be the relative time of an instant, from 0 to 1. The first regressor is the change of the smoothed readings
    `machine_c` (n,) of the machine's thermometer. If there is no thermometer, the first regressor is `change_k` · t,
    where `change_k` is the assumed temperature change of the machine. The second regressor describes machine parts that
    warm up or cool down with a time lag. It is proportional to t, or to t² if there is no thermometer.
    """
    first = int(np.argmin(instants_s))
    time = (instants_s - instants_s[first]) / max(float(np.ptp(instants_s)), 1.0)
    if machine_c is None:
        columns = [change_k * time, SECOND_REGRESSOR_SHARE * change_k * time**2]
    else:
        columns = [smooth_readings(instants_s, machine_c), SECOND_REGRESSOR_SHARE * change_k * time]
    regressors = np.stack(columns, axis=1)
    return np.asarray(regressors - regressors[first])


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
    alone = spread <= 1e-9 * total**2
    safe = np.where(alone, 1.0, spread)
    return np.asarray(np.where(alone, level / total, (second * level - first * slope) / safe))
