"""Time limit of a motion, which is extended as long as the axes approach the target."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from drivers.clock import Clock
from drivers.errors import DeadlineExpired

PROGRESS_MM = 1e-3
"""Reduction of the distance from the target, in mm, that counts as progress.

It exceeds the noise of a displayed position. At 5 % of a feed of 0.1 mm/s, the axes need 0.2 s for it.
"""

REST_MM = 0.01
"""Change of the position in mm below which the axes count as standing still in the text of an error."""


class MotionDeadline:
    """Time limit of a motion to a target.

    The limit is at first `allowed_s` after the start. Whenever the axes have come closer to the target than ever before
    during the motion, at least `stall_s` remain. A motion at a reduced feed override therefore may take as long as it
    needs, and a motion whose axes stand still expires.
    """

    def __init__(
        self, clock: Clock, target_mm: Sequence[float], start_mm: Sequence[float], *, allowed_s: float, stall_s: float
    ) -> None:
        self._clock = clock
        self._target = tuple(target_mm)
        self._allowed_s = allowed_s
        self._stall_s = stall_s
        self._nearest_mm = self._remaining_mm(start_mm)
        self._here = tuple(start_mm)
        self._rest_at = self._here
        self._rest_since_s = clock.now()
        self._expires_s = clock.now() + allowed_s

    def observe(self, position_mm: Sequence[float]) -> None:
        """Take note of a position that the controller has reported during the motion."""
        now_s, self._here = self._clock.now(), tuple(position_mm)
        if math.dist(self._here, self._rest_at) > REST_MM:
            self._rest_at, self._rest_since_s = self._here, now_s
        remaining_mm = self._remaining_mm(self._here)
        if remaining_mm <= self._nearest_mm - PROGRESS_MM:
            self._nearest_mm = remaining_mm
            # The limit is never shortened: a motion at full speed keeps its first allowance.
            self._expires_s = max(self._expires_s, now_s + self._stall_s)

    def restart(self) -> None:
        """Restart the time limit. Call this method while the motion is on hold, because time on hold does not count."""
        self._expires_s = self._clock.now() + self._allowed_s
        self._rest_since_s = self._clock.now()

    @property
    def expired(self) -> bool:
        return self._clock.now() >= self._expires_s

    def raise_if_expired(self, motion: str, where: Mapping[str, str]) -> None:
        """Raise DeadlineExpired if the time limit has passed. `motion` names the motion in the message.

        If the axes stand still, the message says so, where they stand and how far it still is.
        """
        if not self.expired:
            return
        still_s = self._clock.now() - self._rest_since_s
        x, y, z = self._here
        place = f"near X {x:.3f} Y {y:.3f} Z {z:.3f}, {self._remaining_mm(self._here):.3f} mm before the target"
        if still_s >= min(self._stall_s, self._allowed_s) / 2.0:
            raise DeadlineExpired(
                f"timed out waiting for the end of {motion}: the axes have stood still for {still_s:.1f} s {place}, "
                "and the controller reports the motion as in progress",
                hint="check the feed override (0 %?), the rapid override and feed hold at the panel, and the enable "
                "signals of the axes; then continue with `volcal resume`",
                **where,
            )
        raise DeadlineExpired(
            f"timed out waiting for the end of {motion}: the axes move, but do not approach the target ({place})",
            hint="check the controller: does another program or person move the axes?",
            **where,
        )

    def _remaining_mm(self, position_mm: Sequence[float]) -> float:
        return math.dist(position_mm, self._target)
