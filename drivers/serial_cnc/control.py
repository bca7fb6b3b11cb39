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

    def __init__(self, conversation: Conversation, watch: StatusTracker, clock: Clock) -> None:
        self._conversation = conversation
        self._watch = watch
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
        self.look()

    def look(self) -> TrackedStatus:
        """A report; finishes a stop if the axes have come to rest."""
        look = self._watch.look()
        if self._stopping and look.state is not MotionState.MOVING:
            if look.state is not MotionState.FAULT:
                look = self._forget_motion()
            self._stopping = self._watch.ours_moves = False
        return look

    def finish(self) -> None:
        """Before the line is closed: a real machine comes to rest by itself, and then forgets what was held."""
        give_up_s = wall_seconds() + CLOSE_WITHIN_S
        while self._stopping and wall_seconds() < give_up_s:
            self.look()
            self._conversation.idle_for(CLOSE_POLL_S)

    def ready(self, within_s: float) -> TrackedStatus:
        """A report that lets a motion begin. PermissionMissing or CommandRejected where it does not."""
        deadline = Deadline.after(self._clock, within_s)
        look = self.look()
        while self._stopping:
            deadline.require("the axes to rest after a stop", hint="see the controller", **self._conversation.where)
            self._clock.sleep(CLOSE_POLL_S)
            look = self.look()
        if look.missing:
            raise PermissionMissing(
                f"motion refused: {look.missing}" + (f"; {look.fault}" if look.fault else ""),
                hint="make the machine ready: home it, close the door, stop the spindle, end other programs",
                **self._conversation.where,
            )
        if look.state is not MotionState.IDLE:
            raise CommandRejected(
                f"the controller is not idle: {look.word}",
                hint="resume or reset what is held there, then start again",
                **self._conversation.where,
            )
        return look

    def reset(self) -> None:
        """Unlock after an alarm that has kept the position, or after a door that is closed again. CommandRejected where
        homing is needed."""
        look = self.look()
        if look.word == DOOR_CLOSED_AGAIN:
            self._forget_motion()
            return
        if look.state is not MotionState.FAULT:
            return
        if look.alarm not in POSITION_KEPT:
            raise CommandRejected(
                f"not unlocked: {look.fault}, the position is not certain",
                hint="home the machine ($H), then start again",
                **self._conversation.where,
            )
        self.unlock()

    def _forget_motion(self) -> TrackedStatus:
        """A soft reset of axes that rest: what was planned is gone, the position stays."""
        self._conversation.reset()
        self._watch.expect_restart()
        return self._watch.look()

    def unlock(self) -> None:
        self._conversation.ask("$X")
        self._watch.look()
