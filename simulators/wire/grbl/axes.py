"""Axes and probe of a simulated GRBL controller.

The axes execute one planned move at a time, in whole steps. The probe has an input pin and a latch for the position.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from drivers.errors import CommandRejected
from drivers.roles import MotionState, Permission
from simulators.wire.grbl.blocks import Triple, single
from simulators.wire.grbl.physics import GrblPhysics, MachineCoordinates
from simulators.wire.grbl.settings import HARD_LIMITS, PULL_OFF, RATE, TRAVEL, GrblSettings


@dataclass(frozen=True)
class PlannedMove:
    """Move to a target in machine coordinates, in mm. A feed of None means rapid speed."""

    target_mm: Triple
    feed_mm_per_min: float | None


class GrblAxes:
    """Axes that execute the moves that the planner of a simulated GRBL controller has accepted.

    `current_move` holds a move from its start until the controller has noticed its end.
    """

    def __init__(self, physics: GrblPhysics, settings: GrblSettings, now: Callable[[], float]) -> None:
        self._physics = physics
        self._settings = settings
        self._now = now
        self._coordinates = MachineCoordinates(physics.limits(), settings)
        self._leaving = False
        self.current_move: PlannedMove | None = None
        self.released_at_mm: Triple | None = None

    @property
    def moving(self) -> bool:
        return self._physics.motion is MotionState.MOVING

    @property
    def failed(self) -> bool:
        """True after a collision or any other event that has stopped the drives."""
        return self._physics.motion is MotionState.FAULT

    @property
    def idle(self) -> bool:
        return self._physics.motion is MotionState.IDLE

    @property
    def door_open(self) -> bool:
        return not self._physics.permissions[Permission.DOORS_CLOSED]

    @property
    def pin(self) -> bool:
        """State of the probe's input pin. If setting ``$6`` is 0, the pin is True while the probe is deflected.

        If ``$6`` is 1, the state is inverted.
        """
        return self._physics.probe_deflected != self._settings.flag(6)

    @property
    def latches(self) -> int:
        return self._physics.latch.sequence if self._physics.latch is not None else 0

    @property
    def feed_mm_per_min(self) -> float:
        if self.current_move is None or not self.moving:
            return 0.0
        feed = self.current_move.feed_mm_per_min
        return max(self._settings.axes(RATE)) if feed is None else feed

    def position(self) -> Triple:
        """Return the position in machine coordinates: a whole number of steps, in single precision."""
        return self._coordinates.from_axes(self._physics.displayed_position())

    def latch_after(self, latches: int) -> Triple | None:
        """Return the position latched at the latest trip, in machine coordinates.

        Returns None if there was no trip, or if the number of the latest trip is not above `latches`.
        """
        latch = self._physics.latch
        return self._coordinates.from_axes(latch.position) if latch is not None and latch.sequence > latches else None

    def beyond_travel(self, target_mm: Triple) -> bool:
        """Return True if the soft limits do not allow the target, in single precision as in GRBL."""
        settings = self._settings
        shrunk = settings.dialect.pull_off_shrinks_travel and int(settings[HARD_LIMITS]) & 1
        pull_off = settings[PULL_OFF] if shrunk else 0.0
        return any(
            value > single(-pull_off) or value < single(pull_off - length)
            for value, length in zip(target_mm, settings.axes(TRAVEL), strict=True)
        )

    def at(self, target_mm: Triple) -> bool:
        """Return True if the axes stand at `target_mm` to the step, so that a move there is no motion."""
        return self._coordinates.rounded(target_mm) == self.position()

    def begin(self, move: PlannedMove, *, touching: bool = False, leaving: bool = False) -> bool:
        """Start a move, and return False if the simulated machine refuses the move.

        If `touching` is True, the move ends at a trip of the probe. If `leaving` is True, the move ends when the probe
        comes free.
        """
        self.current_move, self._leaving, self.released_at_mm = move, leaving, None
        target = np.array(self._coordinates.to_axes(move.target_mm))
        feed = None if move.feed_mm_per_min is None else move.feed_mm_per_min / 60.0
        try:
            if touching:
                self._physics.begin_touch(target, feed or max(self._settings.axes(RATE)) / 60.0)
            else:
                self._physics.begin_move(target, feed, guarded=False)
        except CommandRejected:
            self.current_move = None
            return False
        return True

    def watch_pin(self) -> None:
        """Brake the axes if the current move was to end when the probe comes free, and the probe has come free."""
        if not self._leaving or self.released_at_mm is not None:
            return
        free_s = self._physics.probe_free_s
        # It may have come free while the axes braked for a hold; this shows only when they move again.
        free = self._now() >= free_s if free_s is not None else self.moving and not self.pin
        if free:
            self.released_at_mm = self.position()
            self._physics.halt()

    def next_event_s(self) -> float | None:
        """Return the machine time in s of the next event of the current move, or None if no event is known.

        The event is the end of the motion or, if this is earlier and the move is to end there, the instant at which the
        probe comes free.
        """
        free_s = self._physics.probe_free_s if self._leaving and self.released_at_mm is None else None
        known = [instant for instant in (self._physics.motion_ends_s, free_s) if instant is not None]
        return min(known, default=None)

    def set_zero(self) -> None:
        """Set the zero of every axis anew, at the end of a homing."""
        self._physics.set_zero()

    def hold(self) -> None:
        self._physics.hold()

    def resume(self) -> None:
        self._physics.resume()

    def abort(self) -> None:
        self.current_move, self._leaving = None, False
        self._physics.halt()

    def clear_fault(self) -> None:
        self._physics.reset()
