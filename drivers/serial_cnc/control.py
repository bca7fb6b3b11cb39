"""Hold, resume, stop and reset of a GRBL controller.

A stop has two phases: a feed hold, and a soft reset after the axes have come to rest.
"""

from __future__ import annotations

from drivers.clock import Clock, Deadline, without_interrupts
from drivers.errors import CommandRejected, DeviceError, MotionFault, PermissionMissing
from drivers.roles import MotionState
from drivers.serial_cnc.codes import POSITION_KEPT
from drivers.serial_cnc.conversation import CANCEL_JOG, HOLD, RESUME, Conversation
from drivers.serial_cnc.status_tracker import StatusTracker, TrackedStatus

CLOSE_WITHIN_S = 1.0
CLOSE_POLL_S = 0.05
RESEND_WITHIN_S, RESEND_EVERY_S = 6.0, 0.25
HELD = "Hold"
HOLD_POLL_S = 0.2
DOOR_CLOSED_AGAIN = "Door:0"
"""State word while the door is closed again and the controller waits for a resume."""


class MotionControl:
    """Hold, resume, stop and reset of a GRBL controller.

    A stop has two phases. The feed hold is sent at once and does not lose the position. Once the axes are at rest, a
    later call of `read_status` sends a soft reset, which discards the rest of the motion. A soft reset during braking
    would lose the position (alarm 3).
    """

    def __init__(self, conversation: Conversation, tracker: StatusTracker, clock: Clock) -> None:
        self._conversation = conversation
        self._tracker = tracker
        self._clock = clock
        self._stopping = False
        self.hold_sent = False
        """True if the feed hold of the latest stop could be sent."""

    @property
    def stopping(self) -> bool:
        """True if a stop was requested and its second phase (the soft reset after the axes have come to rest) is still
        pending.
        """
        return self._stopping

    def hold(self) -> None:
        self._conversation.realtime(HOLD)

    def resume(self) -> None:
        self._conversation.realtime(RESUME)

    def stop(self) -> None:
        """Send a feed hold, the first phase of a stop, and return before the axes are at rest.

        The feed hold overtakes everything unsent, on a new connection if the present one is lost or stalled. The method
        does not wait for standstill because it may be called from inside a sleep of the clock.
        """
        self._stopping, self.hold_sent = True, False
        self._conversation.urgent(CANCEL_JOG + HOLD)
        self.hold_sent = True
        self.read_status()

    def read_status(self) -> TrackedStatus:
        """Query the status, complete a pending stop with a soft reset if the axes have come to rest, and return the
        status.
        """
        status = self._tracker.read_status()
        if self._stopping and status.state is not MotionState.MOVING:
            if status.state is not MotionState.FAULT:
                status = self._discard_motion()
            self._stopping = self._tracker.own_motion = False
        return status

    def finish(self) -> None:
        """Complete a pending stop before the serial line is closed.

        If its feed hold could not be sent because the line was lost, sending is tried for `RESEND_WITHIN_S`: the cable
        may have been plugged in again. Waits up to `CLOSE_WITHIN_S` seconds in the time of
        the link for the axes to come to rest.
        """
        self._send_missing_hold()
        deadline_s = self._conversation.line.seconds() + CLOSE_WITHIN_S
        while self._stopping and self._conversation.line.seconds() < deadline_s:
            self.read_status()
            self._conversation.drain_for(CLOSE_POLL_S)

    def _send_missing_hold(self) -> None:
        clock = without_interrupts(self._clock)
        deadline = Deadline.after(clock, RESEND_WITHIN_S)
        while self._stopping and not self.hold_sent and not deadline.expired:
            try:
                self.stop()
            except DeviceError:
                clock.sleep(RESEND_EVERY_S)

    def require_ready(self, within_s: float) -> TrackedStatus:
        """Wait up to `within_s` seconds for the end of a pending stop, and return a status in which a motion can start.

        Raises DeadlineExpired if the stop does not end in time. Raises PermissionMissing or CommandRejected if the
        machine is not ready.
        """
        deadline = Deadline.after(self._clock, within_s)
        status = self.read_status()
        while self._stopping:
            deadline.raise_if_expired(
                "the axes to rest after a stop", hint="check the controller", **self._conversation.where
            )
            self._clock.sleep(CLOSE_POLL_S)
            status = self.read_status()
        status = self._await_release(status)
        if status.missing:
            raise PermissionMissing(
                f"motion refused: {status.missing}" + (f"; {status.fault}" if status.fault else ""),
                hint=status.remedy,
                **self._conversation.where,
            )
        if status.state is not MotionState.IDLE:
            raise CommandRejected(
                f"the controller is not idle: {status.word}",
                hint="resume or reset the held motion at the controller, then start again",
                **self._conversation.where,
            )
        return status

    def _await_release(self, status: TrackedStatus) -> TrackedStatus:
        """Wait for the release of a feed hold that a person has pressed between two motions.

        Refusing the motion would end the run with a stop, which discards the hold.
        """
        max_hold_s = self._conversation.settings.max_hold_s
        deadline = Deadline.after(self._clock, max_hold_s)
        while status.word.startswith(HELD) and not self._stopping:
            if deadline.expired:
                raise MotionFault(
                    f"held at the machine for more than {max_hold_s:g} s",
                    hint="release the feed hold and start the run again",
                    **self._conversation.where,
                )
            self._clock.sleep(HOLD_POLL_S)
            status = self.read_status()
        return status

    def reset(self) -> None:
        """Unlock the controller after an alarm, or discard the rest of a motion that an open door has interrupted.

        An alarm is unlocked only if the position remained known; otherwise homing is needed, and CommandRejected is
        raised. A motion is discarded only after the door has been closed. Does nothing in any other state.
        """
        status = self.read_status()
        if status.word == DOOR_CLOSED_AGAIN:
            self._discard_motion()
            return
        if status.state is not MotionState.FAULT:
            return
        if status.alarm not in POSITION_KEPT:
            raise CommandRejected(
                f"not unlocked: {status.fault}, the position is not certain",
                hint=status.remedy,
                **self._conversation.where,
            )
        self.unlock()

    def _discard_motion(self) -> TrackedStatus:
        """Discard the planned motion by a soft reset, which keeps the position because the axes are at rest."""
        self._conversation.reset()
        self._tracker.expect_restart()
        return self._tracker.read_status()

    def unlock(self) -> None:
        self._conversation.ask("$X")
        self._tracker.read_status()
