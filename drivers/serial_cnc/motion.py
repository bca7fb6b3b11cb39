"""One motion from its line to its end.

``ok`` to a motion means that it is planned. Its end is the ``ok`` to ``G4 P0``, which the controller answers once
everything planned is done; a probe cycle is answered at its own end.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

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
from drivers.roles import MotionState, Permission, Vector
from drivers.serial_cnc.codes import ALARM_PROBE_STATE
from drivers.serial_cnc.control import MotionControl
from drivers.serial_cnc.conversation import Conversation, SentLine
from drivers.serial_cnc.frames import CoordinateFrames
from drivers.serial_cnc.polling import DurationPrediction, PollSchedule
from drivers.serial_cnc.status_tracker import StatusTracker, TrackedStatus

PREAMBLE = "G21G90G94"
"""Millimetres, absolute, mm/min: every line says so itself, whatever somebody else has left."""
BARRIER = "G4P0"
PROBE_PROTECTED_ALARM = 13
ANSWER_LOST_AFTER = 4
"""Looks that find the axes idle while the answer is still missing."""


@dataclass(frozen=True)
class MotionOrder:
    """A line and what it is meant to do. Machine coordinates."""

    line: str
    what: str
    goal_mm: Vector
    feed_mm_per_s: float | None
    slice_s: float
    barrier: bool


class SerialMotion:
    """Carries out orders. Whatever exception leaves a wait, a stop is sent before it travels on."""

    def __init__(
        self,
        conversation: Conversation,
        watch: StatusTracker,
        control: MotionControl,
        frames: CoordinateFrames,
        clock: Clock,
    ) -> None:
        self._conversation = conversation
        self._watch = watch
        self._control = control
        self._frames = frames
        self._clock = clock
        self._settings = conversation.settings
        self.where = conversation.where

    def ready(self) -> TrackedStatus:
        return self._control.ready(self._settings.motion_margin_s)

    def straight(self, target_mm: Vector, feed_mm_per_s: float | None) -> None:
        """G0 or G1 to displayed positions, without a look at the probe."""
        start = self.ready().position_mm
        goal = self._frames.machine(target_mm)
        word = "G0" if feed_mm_per_s is None else "G1"
        line = f"{PREAMBLE}G53{word}{axis_words(goal)}"
        if feed_mm_per_s is not None:
            line += feed_word(feed_mm_per_s)
        order = MotionOrder(line, "move", goal, feed_mm_per_s, self._settings.poll_interval_s, barrier=True)
        self.require_at(goal, self.carry_out(order, start), "move")

    def carry_out(self, order: MotionOrder, start_mm: Vector) -> TrackedStatus:
        """Send and wait for the end; the report after it."""
        conversation = self._conversation
        conversation.probe_results.clear()
        surprises = self._watch.surprises
        self._watch.ours_moves = True
        try:
            ticket = conversation.send(order.line)
            if order.barrier:
                self._await_planned(ticket)
                ticket = conversation.send(BARRIER)
            look = self._await_end(ticket, order, start_mm, surprises)
        except BaseException as error:
            if not isinstance(error, CommandRejected):
                self._stop_because_of(error)
            raise
        finally:
            self._watch.ours_moves = False
        conversation.require_accepted(ticket)
        return look

    def require_at(self, goal_mm: Vector, look: TrackedStatus, what: str) -> None:
        off_mm = float(np.linalg.norm(look.position_mm - goal_mm))
        if off_mm > self._settings.position_tolerance_mm:
            raise MotionFault(
                f"{what} ended {off_mm:.3f} mm from its target",
                hint="did somebody reset, hold or jog the machine? compare the work offset",
                **self.where,
            )

    def _await_planned(self, ticket: SentLine) -> None:
        """`ok` comes at once. An alarm in its place is told by the next look."""
        try:
            self._conversation.await_answer(ticket)
        except (LinkTimeout, ProtocolError):
            if self._conversation.alarm is None:
                raise
            self._require_sound(self._watch.look(), "move")
            raise
        self._conversation.require_accepted(ticket)

    def _await_end(self, ticket: SentLine, order: MotionOrder, start_mm: Vector, surprises: int) -> TrackedStatus:
        look = self._watch.look()
        predicted_s = DurationPrediction(self._frames.limits).of(
            start_mm, order.goal_mm, order.feed_mm_per_s, look.slowest_share
        )
        pace = PollSchedule(self._clock, self._settings, predicted_s, order.slice_s)
        held: Deadline | None = None
        idle = 0
        while True:
            self._require_same(surprises, order.what)
            self._require_sound(look, order.what)
            if self._control.stopping:
                raise MotionFault(f"the {order.what} was stopped", hint="start the run again", **self.where)
            if ticket.answered:
                return look
            if look.state is MotionState.HELD:
                held = held or Deadline.after(self._clock, self._settings.held_at_most_s)
                self._require_resumed(held, look)
                pace.begin_anew()
            else:
                held = None
                pace.deadline.require(f"the end of a {order.what}", hint="see the controller", **self.where)
                idle = idle + 1 if look.state is MotionState.IDLE and pace.fine else 0
                self._require_answer(idle, ticket)
            self._clock.sleep(pace.pause_s())
            look = self._watch.look()

    def _require_same(self, surprises: int, what: str) -> None:
        if self._watch.surprises == surprises:
            return
        self._watch.position_lost = True
        raise MotionFault(
            f"the controller has restarted in the middle of a {what}",
            hint="power, USB or reset button; home the machine before anything else",
            **self.where,
        )

    def _require_sound(self, look: TrackedStatus, what: str) -> None:
        """The alarms and lost permissions that end a motion, each as its own error."""
        if look.state is not MotionState.FAULT:
            return
        if look.alarm == ALARM_PROBE_STATE:
            self._control.unlock()
            raise CommandRejected(f"the probe is deflected before a {what}", hint="back off first", **self.where)
        if look.alarm == PROBE_PROTECTED_ALARM:
            self._control.unlock()
            raise GuardTripped(f"probe tripped in a {what}", hint="see what the probe touched", **self.where)
        raise MotionFault(f"{what} ended in an alarm: {look.fault}", hint="see the controller", **self.where)

    def _require_resumed(self, held: Deadline, look: TrackedStatus) -> None:
        if not look.permissions[Permission.DOORS_CLOSED]:
            raise PermissionMissing("the door was opened in motion", hint="close it, start again", **self.where)
        if held.expired:
            raise MotionFault(
                f"motion held at the machine for more than {self._settings.held_at_most_s:g} s",
                hint="release the feed hold and start the run again",
                **self.where,
            )

    def _require_answer(self, idle: int, ticket: SentLine) -> None:
        if idle >= ANSWER_LOST_AFTER:
            raise ProtocolError(
                f"the axes rest, and no answer to {ticket.line!r} has come",
                hint="it was lost on the line: check cable, shield and baud",
                **self.where,
            )

    def _stop_because_of(self, error: BaseException) -> None:
        try:
            if self._conversation.line.connected:
                self._control.stop()
        except DeviceError as failure:
            error.add_note(f"a feed hold was sent and its effect is not known: {failure}")


def axis_words(position_mm: Vector) -> str:
    """Four decimals: the controller rounds to its steps, not this."""
    return "".join(f"{axis}{value:.4f}" for axis, value in zip("XYZ", position_mm.tolist(), strict=True))


def feed_word(feed_mm_per_s: float) -> str:
    return f"F{60.0 * feed_mm_per_s:.3f}"
