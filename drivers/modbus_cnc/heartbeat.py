"""Monitor of the heartbeat of a Modbus controller."""

from __future__ import annotations

from collections.abc import Mapping

from drivers.clock import Clock
from drivers.errors import LinkLost


class PeerHeartbeat:
    """Monitor that raises LinkLost if a controller's heartbeat (a counter) has not changed for more than `lost_after_s`
    seconds.

    If more than `lost_after_s` seconds pass between two calls of `observe`, an unchanged heartbeat proves nothing, and
    the monitor restarts its measurement of time.
    """

    def __init__(self, clock: Clock, lost_after_s: float, where: Mapping[str, str]) -> None:
        self._clock = clock
        self._lost_after_s = lost_after_s
        self._where = where
        self._value = -1
        self._changed_s = 0.0
        self._observed_s = float("-inf")

    def observe(self, value: int) -> None:
        now_s = self._clock.now()
        watching = now_s - self._observed_s <= self._lost_after_s
        self._observed_s = now_s
        if value != self._value or not watching:
            self._value, self._changed_s = value, now_s
        elif now_s - self._changed_s > self._lost_after_s:
            raise LinkLost(
                f"the controller's heartbeat has been stuck at {value} for {now_s - self._changed_s:.1f} s",
                hint="its Modbus server answers, but its program does not run; check the controller",
                **self._where,
            )
