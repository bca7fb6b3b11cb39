"""Predicted duration of a motion, and the schedule of status queries during it."""

from __future__ import annotations

import math

from drivers.clock import Clock
from drivers.motion_deadline import MotionDeadline
from drivers.roles import AxisLimits, Vector
from drivers.serial_cnc.settings import SerialCncSettings
from drivers.straight_move import move_duration_s

DURATION_FACTOR = 1.5
"""Ratio of a motion's time limit to its predicted duration, before `motion_margin_s` is added.

It allows for look-ahead and junctions.
"""
COARSEST_FINE_S = 0.1
END_MARGIN_S = 0.001
"""Time in s between the predicted end and the query for it; a query exactly at that end would often be too early."""


class DurationPrediction:
    def __init__(self, limits: AxisLimits) -> None:
        self._limits = limits

    def of(self, start_mm: Vector, goal_mm: Vector, feed_mm_per_s: float | None, slowest_share: float) -> float:
        """Return the predicted duration of a straight motion in s.

        `slowest_share` is the factor, at most 1, by which the controller's feed and rapid overrides reduce the speed.
        """
        at_full_speed_s = move_duration_s(
            start_mm.tolist(),
            goal_mm.tolist(),
            feed_mm_per_s=feed_mm_per_s,
            rapid_mm_per_s=self._limits.rapid_mm_per_s,
            acceleration_mm_per_s2=self._limits.acceleration_mm_per_s2,
        )
        return at_full_speed_s / slowest_share


class PollSchedule:
    """Schedule of status queries during a motion.

    The pauses between queries are long until the predicted end of the motion. After that, they are short at first and
    grow.
    """

    def __init__(
        self,
        clock: Clock,
        settings: SerialCncSettings,
        predicted_s: float,
        slice_s: float,
        start_mm: Vector,
        goal_mm: Vector,
    ) -> None:
        """`start_mm` and `goal_mm` are the ends of the motion in the coordinates of the reported positions."""
        self._clock = clock
        self._slice_s = slice_s
        self._end_s = clock.now() + predicted_s + END_MARGIN_S
        self._fine_s = settings.fine_poll_interval_s
        self.deadline = MotionDeadline(
            clock,
            goal_mm.tolist(),
            start_mm.tolist(),
            allowed_s=DURATION_FACTOR * predicted_s + settings.motion_margin_s,
            stall_s=settings.motion_margin_s,
        )

    @property
    def past_predicted_end(self) -> bool:
        """True if the predicted end of the motion has passed."""
        return self._clock.now() >= self._end_s

    def restart(self) -> None:
        """Restart the time limit of a motion that is on hold, because time on hold does not count."""
        self.deadline.restart()

    def pause_s(self) -> float:
        left_s = self._end_s - self._clock.now()
        if left_s > self._fine_s:
            return left_s / math.ceil(left_s / self._slice_s)
        pause_s, self._fine_s = self._fine_s, min(1.5 * self._fine_s, COARSEST_FINE_S, self._slice_s)
        return pause_s
