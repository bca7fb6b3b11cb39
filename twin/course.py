"""In which ways a machine may have changed from instant to instant: the regressors of its drift, in kelvin."""

from __future__ import annotations

import numpy as np

from twin.arrays import Array
from twin.legendre import legendre_values

POWERS = (0.15, 0.07)
"""Share of the whole change of temperature that each Legendre order of the time may have besides the thermometer's own
course: what warms with a lag of its own follows no thermometer, yet is smooth."""
SMOOTHED_OVER_S = 150.0


def machine_course(instants_s: Array, machine_c: Array | None, change_k: float) -> Array:
    """(n, w) K: how far a machine had drifted at instants (n,) since the first of them.

    Along with its thermometer (n,), where there is one, and along the first powers of the time as far as a whole
    change of `change_k` permits.
    """
    first = int(np.argmin(instants_s))
    span_s = max(float(np.ptp(instants_s)), 1.0)
    ways = legendre_values(2.0 * (instants_s - instants_s[first]) / span_s - 1.0, len(POWERS))[1:]
    columns = [change_k * share * way for share, way in zip(POWERS, ways, strict=True)]
    if machine_c is not None:
        columns.insert(0, smoothed(instants_s, machine_c))
    course = np.stack(columns, axis=1)
    return np.asarray(course - course[first])


def smoothed(instants_s: Array, values: Array, half_window_s: float = SMOOTHED_OVER_S) -> Array:
    """(n,) readings without most of their noise: a straight line through those near in time, at each instant."""
    away = (instants_s[None, :] - instants_s[:, None]) / half_window_s
    weight = np.clip(1.0 - away**2, 0.0, None)
    total, first, second = (np.einsum("ij,ij->i", weight, away**power) for power in (0, 1, 2))
    level, slope = weight @ values, (weight * away) @ values
    spread = total * second - first**2
    alone = spread <= 1e-9 * total**2
    safe = np.where(alone, 1.0, spread)
    return np.asarray(np.where(alone, level / total, (second * level - first * slope) / safe))
