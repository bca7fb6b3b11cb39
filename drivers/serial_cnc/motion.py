"""Motions of a GRBL controller, from sending the line to the end of the motion.

The ``ok`` to a motion line means only that the motion is planned. The ``ok`` to a following ``G4 P0`` comes when all
planned motions are complete. The ``ok`` to a probe cycle comes at the end of the cycle.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from drivers.clock import Clock, Deadline
from drivers.errors import (
    CommandRejected,
    DeviceError,
    GuardTripped,
    LinkTimeout,
    MotionFault,
    PermissionMissing,
    ProtocolError,
)
from drivers.motion_deadline import MotionDeadline
from drivers.reached_position import require_reached
from drivers.roles import AxisLimits, MotionState, Permission, Vector
from drivers.serial_cnc.codes import ALARM_PROBE_STATE
from drivers.serial_cnc.control import MotionControl
from drivers.serial_cnc.conversation import Conversation, SentLine
from drivers.serial_cnc.frames import CoordinateFrames
from drivers.serial_cnc.settings import SerialCncSettings
from drivers.serial_cnc.status_tracker import StatusTracker, TrackedStatus
from drivers.straight_move import move_duration_s

PREAMBLE = "G21G90G94"
"""Codes for millimetres, absolute targets and mm/min.

They are part of every line, since another user may have left other modes active.
"""
BARRIER = "G4P0"
PROBE_PROTECTED_ALARM = 13
DURATION_FACTOR = 1.5
"""Ratio of a motion's time limit to its predicted duration, before `motion_margin_s` is added.

It allows for look-ahead and junctions.
"""
COARSEST_FINE_S = 0.1
END_MARGIN_S = 0.001
"""Time in s between the predicted end and the query for it; a query exactly at that end would often be too early."""


@dataclass(frozen=True)
class MotionOrder:
    """Order for one motion: the line to send, and the goal expected at the end, in machine coordinates (mm).

    `what` names the motion in messages. `slice_s` is the longest pause between two status queries. If `barrier` is
    True, a ``G4 P0`` is sent after the line, and its answer shows the end of the motion.
    """

    line: str
    what: str
    goal_mm: Vector
    feed_mm_per_s: float | None
    slice_s: float
    barrier: bool


class SerialMotion:
    """Executor of motions on a GRBL controller.

    If an exception other than CommandRejected ends the wait for a motion, a stop is sent before the exception
    propagates.
    """

    def __init__(
        self,
        conversation: Conversation,
        tracker: StatusTracker,
        control: MotionControl,
        frames: CoordinateFrames,
        clock: Clock,
    ) -> None:
        self._conversation = conversation
        self._tracker = tracker
        self._control = control
        self._frames = frames
        self._clock = clock
        self._settings = conversation.settings
        self.where = conversation.where

    def require_ready(self) -> TrackedStatus:
        return self._control.require_ready(self._settings.motion_margin_s)

    def move_straight(self, target_mm: Vector, feed_mm_per_s: float | None) -> None:
        """Move in a straight line (G0 or G1) to the displayed axis position `target_mm`, without checking the probe."""
        start = self.require_ready().position_mm
        goal = self._frames.to_machine(target_mm)
        word = "G0" if feed_mm_per_s is None else "G1"
        line = f"{PREAMBLE}G53{word}{axis_words(goal)}"
        if feed_mm_per_s is not None:
            line += feed_word(feed_mm_per_s)
        order = MotionOrder(line, "move", goal, feed_mm_per_s, self._settings.poll_interval_s, barrier=True)
        self.require_at(goal, self.execute(order, start), "move")

    def execute(self, order: MotionOrder, start_mm: Vector) -> TrackedStatus:
        """Send the line of `order`, wait until its motion ends, and return the controller's status at the end."""
        conversation = self._conversation
        conversation.probe_results.clear()
        unexpected_restarts = self._tracker.unexpected_restarts
        self._tracker.own_motion = True
        try:
            sent = conversation.send(order.line)
            if order.barrier:
                self._await_planned(sent)
                sent = conversation.send(BARRIER)
            status = self._await_end(sent, order, start_mm, unexpected_restarts)
        except BaseException as error:
            if not isinstance(error, CommandRejected):
                self._stop_because_of(error)
            raise
        finally:
            self._tracker.own_motion = False
        conversation.require_accepted(sent)
        return status

    def require_at(self, goal_mm: Vector, status: TrackedStatus, what: str) -> None:
        """Raise MotionFault if the axes are not at `goal_mm`; both positions are in machine coordinates."""
        require_reached(
            status.position_mm.tolist(), goal_mm.tolist(), self._settings.position_tolerance_mm, what, self.where
        )

    def _await_planned(self, sent: SentLine) -> None:
        """Wait for the ``ok`` that means that the motion is planned.

        If an alarm comes instead, query the status and raise the error that corresponds to the alarm.
        """
        try:
            self._conversation.await_answer(sent)
        except (LinkTimeout, ProtocolError):
            if self._conversation.alarm is None:
                raise
            self._require_sound(self._tracker.read_status(), "move")
            raise
        self._conversation.require_accepted(sent)

    def _await_end(
        self, sent: SentLine, order: MotionOrder, start_mm: Vector, unexpected_restarts: int
    ) -> TrackedStatus:
        status = self._tracker.read_status()
        predicted_s = DurationPrediction(self._frames.limits).of(
            start_mm, order.goal_mm, order.feed_mm_per_s, status.slowest_share
        )
        schedule = PollSchedule(self._clock, self._settings, predicted_s, order.slice_s, start_mm, order.goal_mm)
        held: Deadline | None = None
        answer_due: Deadline | None = None
        while True:
            self._require_no_restart(unexpected_restarts, order.what)
            schedule.deadline.observe(status.position_mm.tolist())
            self._require_sound(status, order.what)
            if self._control.stopping:
                raise MotionFault(f"the {order.what} was stopped", hint="start the run again", **self.where)
            if sent.answered:
                return status
            if status.state is MotionState.HELD:
                held = held or Deadline.after(self._clock, self._settings.max_hold_s)
                self._require_resumed(held, status)
                schedule.restart()
            else:
                held = None
                schedule.deadline.raise_if_expired(order.what, self.where)
                if status.state is MotionState.IDLE and schedule.past_predicted_end:
                    answer_due = answer_due or Deadline.after(self._clock, self._settings.response_timeout_s)
                    self._require_answer(answer_due, sent)
                else:
                    answer_due = None
            self._clock.sleep(schedule.pause_s())
            status = self._tracker.read_status()

    def _require_no_restart(self, unexpected_restarts: int, what: str) -> None:
        if self._tracker.unexpected_restarts == unexpected_restarts:
            return
        # The axes coast when the controller restarts in motion, so its position afterwards is not theirs.
        self._tracker.position_lost = True
        raise MotionFault(
            f"the controller has restarted in the middle of a {what}",
            hint="check power, USB cable and reset button; home the machine before anything else",
            **self.where,
        )

    def _require_sound(self, status: TrackedStatus, what: str) -> None:
        """Raise the error that corresponds to the alarm if an alarm has ended the motion."""
        if status.state is not MotionState.FAULT:
            return
        if status.alarm == ALARM_PROBE_STATE:
            self._control.unlock()
            raise CommandRejected(f"the probe is deflected before a {what}", hint="withdraw it first", **self.where)
        if status.alarm == PROBE_PROTECTED_ALARM:
            self._control.unlock()
            raise GuardTripped(f"the probe tripped in a {what}", hint="check what the probe touched", **self.where)
        raise MotionFault(f"{what} ended in an alarm: {status.fault}", hint=status.remedy, **self.where)

    def _require_resumed(self, held: Deadline, status: TrackedStatus) -> None:
        if not status.permissions[Permission.DOORS_CLOSED]:
            raise PermissionMissing("the door was opened in motion", hint="close it and start again", **self.where)
        if held.expired:
            raise MotionFault(
                f"motion held at the machine for more than {self._settings.max_hold_s:g} s",
                hint="release the feed hold and start the run again",
                **self.where,
            )

    def _require_answer(self, answer_due: Deadline, sent: SentLine) -> None:
        if answer_due.expired:
            raise ProtocolError(
                f"the axes have been at rest for {self._settings.response_timeout_s:g} s, but no answer to "
                f"{sent.line!r} has come",
                hint="it was lost on the line: check cable, shield and baud",
                **self.where,
            )

    def _stop_because_of(self, error: BaseException) -> None:
        try:
            self._control.stop()
        except DeviceError as failure:
            sent = self._control.hold_sent
            what = "a feed hold was sent, but its effect is unknown" if sent else "the feed hold could not be sent"
            error.add_note(f"{what}: {failure}")


def axis_words(position_mm: Vector) -> str:
    """Return the G-code words for X, Y and Z in mm, as in ``X1.0000Y2.0000Z3.0000``.

    Four decimals are finer than the steps to which the controller rounds.
    """
    return "".join(f"{axis}{value:.4f}" for axis, value in zip("XYZ", position_mm.tolist(), strict=True))


def feed_word(feed_mm_per_s: float) -> str:
    return f"F{60.0 * feed_mm_per_s:.3f}"


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
