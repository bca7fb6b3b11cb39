"""In which ways a machine may have changed from instant to instant: the regressors of its drift, in kelvin."""

from __future__ import annotations

import numpy as np

from twin.arrays import Array

SECOND_REGRESSOR_SHARE = 0.4
"""Share of the whole change of temperature that what lags may have gone along the next power of the time."""
SMOOTHING_HALF_WINDOW_S = 150.0


def thermal_regressors(instants_s: Array, machine_c: Array | None, change_k: float) -> Array:
    """(n, w) K: how far a machine had drifted at instants (n,) since the first of them.

    First along with its thermometer (n,), or where there is none as the time, by `change_k`; then along the next power
    of the time, for what has a lag of its own.
    """
    first = int(np.argmin(instants_s))
    time = (instants_s - instants_s[first]) / max(float(np.ptp(instants_s)), 1.0)
    if machine_c is None:
        columns = [change_k * time, SECOND_REGRESSOR_SHARE * change_k * time**2]
    else:
        columns = [smooth_readings(instants_s, machine_c), SECOND_REGRESSOR_SHARE * change_k * time]
    course = np.stack(columns, axis=1)
    return np.asarray(course - course[first])


def smooth_readings(instants_s: Array, values: Array, half_window_s: float = SMOOTHING_HALF_WINDOW_S) -> Array:
    """(n,) readings without most of their noise: a straight line through those near in time, at each instant."""
    away = (instants_s[None, :] - instants_s[:, None]) / half_window_s
    weight = np.clip(1.0 - away**2, 0.0, None)
    total, first, second = (np.einsum("ij,ij->i", weight, away**power) for power in (0, 1, 2))
    level, slope = weight @ values, (weight * away) @ values
    spread = total * second - first**2
    alone = spread <= 1e-9 * total**2
    safe = np.where(alone, 1.0, spread)
    return np.asarray(np.where(alone, level / total, (second * level - first * slope) / safe))
