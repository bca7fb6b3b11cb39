"""Homing of all axes of a GRBL controller with ``$H``.

GRBL answers ``$H`` with ``ok`` when the axes have left their switches again. Until then it reports no status, and it
obeys no feed hold, so only a soft reset ends a homing. The position is lost afterwards (alarm 6). ``$H`` is accepted in
the alarm state too, because it is the way out of the lock after power-on.

Source: gnea/grbl, doc/markdown/commands.md (``$H``) and interface.md, grbl/system.c and limits.c (`limits_go_home`).
"""

from __future__ import annotations

from drivers.clock import Clock, Deadline
from drivers.errors import CommandRejected, DeviceError, MotionFault
from drivers.roles import MotionState, Permission
from drivers.serial_cnc.control import MotionControl
from drivers.serial_cnc.conversation import SOFT_RESET, Conversation, SentLine
from drivers.serial_cnc.status_tracker import StatusTracker, TrackedStatus

LINES_WITHIN_S = 0.002
"""Wall time in which a poll waits for a line; a line that comes later is read by the next poll."""
HINT = "check the switches, $23 to $27 and what is in the way, then home the machine ($H)"


class SerialHoming:
    """Homing of all axes. If an exception ends the wait for its end, the homing is ended by a soft reset before the
    exception propagates."""

    def __init__(
        self, conversation: Conversation, tracker: StatusTracker, control: MotionControl, clock: Clock
    ) -> None:
        self._conversation = conversation
        self._tracker = tracker
        self._control = control
        self._clock = clock
        self._settings = conversation.settings

    def home(self) -> None:
        """Home all axes and return when they are at rest and homed.

        Raises CommandRejected if the controller refuses, MotionFault if homing ends in an alarm, and DeadlineExpired if
        it does not end in time.
        """
        self._require_startable(self._control.read_status())
        conversation = self._conversation
        conversation.clear_alarm()
        restarts = conversation.restarts
        self._tracker.own_motion = True
        try:
            sent = conversation.send("$H")
            self._await_end(sent, restarts)
        except BaseException as error:
            self._end_because_of(error)
            raise
        finally:
            self._tracker.own_motion = False
        self._require_homed(sent, restarts)

    def _require_startable(self, status: TrackedStatus) -> None:
        where = self._conversation.where
        if not status.permissions[Permission.DOORS_CLOSED]:
            raise CommandRejected("homing refused: the door is open", hint="close it and start again", **where)
        if status.state not in (MotionState.IDLE, MotionState.FAULT):
            raise CommandRejected(
                f"homing refused: the controller is not idle: {status.word}",
                hint="end the motion or the hold at the controller, then start again",
                **where,
            )

    def _await_end(self, sent: SentLine, restarts: int) -> None:
        conversation = self._conversation
        deadline = Deadline.after(self._clock, self._settings.homing_timeout_s)
        while not sent.answered and conversation.alarm is None and conversation.restarts == restarts:
            deadline.raise_if_expired("the end of homing", hint=HINT, **conversation.where)
            self._clock.sleep(self._settings.poll_interval_s)
            conversation.drain_for(LINES_WITHIN_S)

    def _require_homed(self, sent: SentLine, restarts: int) -> None:
        conversation = self._conversation
        alarm = conversation.alarm
        if alarm is None and conversation.restarts == restarts:
            conversation.require_accepted(sent)
        status = self._tracker.read_status()  # reads all that the controller has sent until now
        alarm = conversation.alarm if alarm is None else alarm
        if alarm is not None or conversation.restarts != restarts or status.state is not MotionState.IDLE:
            self._tracker.position_lost = True
            reason = status.fault or f"the controller is in the state {status.word}"
            raise MotionFault(f"homing failed: {reason}", hint=HINT, **conversation.where)
        self._tracker.note_homed()

    def _end_because_of(self, error: BaseException) -> None:
        self._tracker.position_lost = True
        try:
            self._conversation.urgent(SOFT_RESET)
        except DeviceError as failure:
            error.add_note(f"the soft reset that ends the homing could not be sent: {failure}")
