"""Time at which a drifting value will reach its limit: at the expected rate, and at the earliest."""

from __future__ import annotations

import math
from dataclasses import dataclass

from twin.monitoring.drift import Drift

_STEPS = 60  # bisections of the horizon


@dataclass(frozen=True)
class LimitCrossing:
    """Number of nights after the last measured one until `limit` is reached.

    `expected`: until the fitted line reaches the limit; `earliest`: until the edge of its 95 % band reaches it. Both
    are 0 if the limit is already reached, and infinite if it is not reached within the horizon. `reached`: True if the
    fitted line has already reached the limit.
    """

    limit: float
    expected: float
    earliest: float

    @property
    def reached(self) -> bool:
        return self.expected <= 0.0


def limit_crossing(drift: Drift, limit: float, horizon: float, *, two_sided: bool) -> LimitCrossing:
    """Compute the crossing within `horizon` nights.

    `two_sided`: the value must stay within [-limit, limit]; otherwise it must not exceed `limit`.
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
    """Return the first night at which value + k·uncertainty is beyond the limit.

    The edge of the band is convex, so it crosses the limit only once if it begins below. The crossing is found by
    bisection.
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
