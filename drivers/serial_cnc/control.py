"""Hold, resume, stop, reset: what acts at once, and what a stop leaves to be finished."""

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
"""The controller waits to resume."""


class MotionControl:
    """A stop is a feed hold, which keeps the position, and a soft reset once the axes rest, which throws the rest of
    the motion away. The hold acts at once; the reset is sent by whoever looks next. In a braking axis it would cost
    the position (alarm 3)."""

    def __init__(self, conversation: Conversation, tracker: StatusTracker, clock: Clock) -> None:
        self._conversation = conversation
        self._tracker = tracker
        self._clock = clock
        self._stopping = False

    @property
    def stopping(self) -> bool:
        """A stop was asked for, and the axes do not rest yet."""
        return self._stopping

    def hold(self) -> None:
        self._conversation.realtime(HOLD)

    def resume(self) -> None:
        self._conversation.realtime(RESUME)

    def stop(self) -> None:
        """Does not wait for rest: it is called where sleeping is not possible."""
        self._stopping = True
        self._conversation.realtime(CANCEL_JOG + HOLD)
        self.read_status()

    def read_status(self) -> TrackedStatus:
        """A report; finishes a stop if the axes have come to rest."""
        status = self._tracker.read_status()
        if self._stopping and status.state is not MotionState.MOVING:
            if status.state is not MotionState.FAULT:
                status = self._discard_motion()
            self._stopping = self._tracker.own_motion = False
        return status

    def finish(self) -> None:
        """Before the line is closed: a real machine comes to rest by itself, and then forgets what was held."""
        deadline_s = wall_seconds() + CLOSE_WITHIN_S
        while self._stopping and wall_seconds() < deadline_s:
            self.read_status()
            self._conversation.drain_for(CLOSE_POLL_S)

    def require_ready(self, within_s: float) -> TrackedStatus:
        """A report that lets a motion begin. PermissionMissing or CommandRejected where it does not."""
        deadline = Deadline.after(self._clock, within_s)
        status = self.read_status()
        while self._stopping:
            deadline.raise_if_expired(
                "the axes to rest after a stop", hint="see the controller", **self._conversation.where
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
                hint="resume or reset what is held there, then start again",
                **self._conversation.where,
            )
        return status

    def reset(self) -> None:
        """Unlock after an alarm that has kept the position, or after a door that is closed again. CommandRejected where
        homing is needed."""
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
        """A soft reset of axes that rest: what was planned is gone, the position stays."""
        self._conversation.reset()
        self._tracker.expect_restart()
        return self._tracker.read_status()

    def unlock(self) -> None:
        self._conversation.ask("$X")
        self._tracker.read_status()
