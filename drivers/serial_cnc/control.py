"""Hold, resume, stop and reset, including the second phase of a stop after the axes have come to rest."""

from __future__ import annotations

from drivers.clock import Clock, Deadline, wall_seconds
from drivers.errors import CommandRejected, PermissionMissing
from drivers.roles import MotionState
from drivers.serial_cnc.codes import POSITION_KEPT
from drivers.serial_cnc.conversation import CANCEL_JOG, HOLD, RESUME, Conversation
from drivers.serial_cnc.status_tracker import StatusTracker, TrackedStatus

CLOSE_WITHIN_S = 1.0
CLOSE_POLL_S = 0.05
DOOR_CLOSED_AGAIN = "Door:0"
"""State with the door closed again, in which the controller waits for a resume."""


class MotionControl:
    """Hold, resume, stop and reset of the controller.

    A stop is a feed hold, which keeps the position, followed by a soft reset once the axes are at rest, which discards
    the rest of the motion. The hold is sent at once, the reset at a later status query: during braking it would lose
    the position (alarm 3).
    """

    def __init__(self, conversation: Conversation, tracker: StatusTracker, clock: Clock) -> None:
        self._conversation = conversation
        self._tracker = tracker
        self._clock = clock
        self._stopping = False

    @property
    def stopping(self) -> bool:
        """True if a stop was requested and the axes are not yet at rest."""
        return self._stopping

    def hold(self) -> None:
        self._conversation.realtime(HOLD)

    def resume(self) -> None:
        self._conversation.realtime(RESUME)

    def stop(self) -> None:
        """Send the feed hold. Does not wait for standstill, because callers may be unable to sleep."""
        self._stopping = True
        self._conversation.realtime(CANCEL_JOG + HOLD)
        self.read_status()

    def read_status(self) -> TrackedStatus:
        """Query the status; complete a pending stop if the axes have come to rest."""
        status = self._tracker.read_status()
        if self._stopping and status.state is not MotionState.MOVING:
            if status.state is not MotionState.FAULT:
                status = self._discard_motion()
            self._stopping = self._tracker.own_motion = False
        return status

    def finish(self) -> None:
        """Complete a pending stop before the line is closed, waiting in wall time for the axes to come to rest."""
        deadline_s = wall_seconds() + CLOSE_WITHIN_S
        while self._stopping and wall_seconds() < deadline_s:
            self.read_status()
            self._conversation.drain_for(CLOSE_POLL_S)

    def require_ready(self, within_s: float) -> TrackedStatus:
        """Return a status in which a motion can start; raise PermissionMissing or CommandRejected if it cannot."""
        deadline = Deadline.after(self._clock, within_s)
        status = self.read_status()
        while self._stopping:
            deadline.raise_if_expired(
                "the axes to rest after a stop", hint="check the controller", **self._conversation.where
            )
            self._clock.sleep(CLOSE_POLL_S)
            status = self.read_status()
        if status.missing:
            raise PermissionMissing(
                f"motion refused: {status.missing}" + (f"; {status.fault}" if status.fault else ""),
                hint="make the machine ready: home it, close the door, stop the spindle, end other programs",
                **self._conversation.where,
            )
        if status.state is not MotionState.IDLE:
            raise CommandRejected(
                f"the controller is not idle: {status.word}",
                hint="resume or reset the held motion at the controller, then start again",
                **self._conversation.where,
            )
        return status

    def reset(self) -> None:
        """Unlock after an alarm that did not lose the position, or after the door was closed again.

        Raises CommandRejected if homing is needed.
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
                hint="home the machine ($H), then start again",
                **self._conversation.where,
            )
        self.unlock()

    def _discard_motion(self) -> TrackedStatus:
        """Discard the planned motion by a soft reset with the axes at rest, which keeps the position."""
        self._conversation.reset()
        self._tracker.expect_restart()
        return self._tracker.read_status()

    def unlock(self) -> None:
        self._conversation.ask("$X")
        self._tracker.read_status()
