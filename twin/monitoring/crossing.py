"""Prediction of the night in which a drifting value will reach its limit: the expected and the earliest night."""

from __future__ import annotations

import math
from dataclasses import dataclass

from twin.monitoring.drift import Drift

# 2⁻⁶⁰ of the horizon is below the rounding of a double.
_STEPS = 60  # bisections of the horizon


@dataclass(frozen=True)
class LimitCrossing:
    """Number of nights from the last measured night until a drifting value reaches `limit`.

    `expected` is the number of nights until the straight line fitted to the measured values reaches the limit.
    `earliest` is the number of nights until the edge of the 95 % uncertainty band of this line reaches the limit. Each
    number is 0 if the limit is already reached, and infinite if the limit is not reached within the horizon of the
    computation.
    """

    limit: float
    expected: float
    earliest: float

    @property
    def reached(self) -> bool:
        return self.expected <= 0.0


def limit_crossing(drift: Drift, limit: float, horizon: float, *, two_sided: bool) -> LimitCrossing:
    """Return the number of nights until the fitted `drift` reaches `limit`, as expected and at the earliest.

    `limit` has the unit of the values to which `drift` was fitted. Only the next `horizon` nights are considered. If
    `two_sided`, the limits are `limit` and -`limit`; otherwise `limit` is the only limit, an upper one.
    """
    sides = (1.0, -1.0) if two_sided else (1.0,)
    expected = min(_line(drift, limit, side, horizon) for side in sides)
    earliest = min(_band(drift, limit, side, horizon) for side in sides)
    return LimitCrossing(limit, expected, min(earliest, expected))


def _line(drift: Drift, limit: float, side: float, horizon: float) -> float:
    room = limit - side * drift.level
    if room <= 0.0:
        return 0.0
    rate = side * drift.slope
    return room / rate if rate > 0.0 and room <= rate * horizon else math.inf


def _band(drift: Drift, limit: float, side: float, horizon: float) -> float:
    """Return the first night at which the upper edge of the band, value + coverage factor · uncertainty, reaches the
    limit.

    `side` is -1 for the lower limit, for which the sign of the value is reversed. The edge of the band is convex, so it
    crosses the limit only once if it begins below the limit. This night is found by bisection. The result is 0 if the
    edge is already beyond the limit, and infinite if it does not reach the limit within the horizon.
    """

    def beyond(nights: float) -> bool:
        value, sigma = drift.predict(nights)
        return side * value + drift.factor * sigma >= limit

    if beyond(0.0):
        return 0.0
    if not beyond(horizon):
        return math.inf
    low, high = 0.0, horizon
    for _ in range(_STEPS):
        middle = 0.5 * (low + high)
        low, high = (low, middle) if beyond(middle) else (middle, high)
    return high
