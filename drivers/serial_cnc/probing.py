"""Probe cycles: touches, guarded moves, and backing off with a deflected probe.

Cycle G38.3 ends when the probe trips, and cycle G38.5 ends when the probe comes free. Both cycles also end at their
target, without an alarm. The targets of both cycles are in work coordinates, since G53 cannot be combined with a probe
cycle. The results of both cycles are in machine coordinates.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from drivers.errors import CommandRejected, GuardTripped, MotionFault, ProtocolError
from drivers.roles import Miss, Touch, Vector
from drivers.serial_cnc.controller_settings import ControllerSettings
from drivers.serial_cnc.conversation import Conversation
from drivers.serial_cnc.frames import CoordinateFrames
from drivers.serial_cnc.lines import ProbeResult
from drivers.serial_cnc.motion import PREAMBLE, MotionOrder, SerialMotion, axis_words, feed_word
from drivers.serial_cnc.status_tracker import StatusTracker, TrackedStatus
from drivers.straight_move import distance_to_segment_mm, limit_along_direction

UNTIL_CONTACT, UNTIL_FREE = "G38.3", "G38.5"
SAME_POSITION = "33"
"""Error of a probe cycle whose target is where the controller already stands."""


@dataclass(frozen=True)
class ProbeCycleResult:
    """Result of a probe cycle (G38.3 or G38.5), and the controller's status after the cycle."""

    result: ProbeResult
    status: TrackedStatus


class SerialProbing:
    """Touches and guarded moves by means of probe cycles.

    No cycle is sent if the axes stand at its target as far as a report can tell: it would not move them, and the
    controller refuses one whose target is the position that it has computed itself (error 33).

    A latched position is accepted only if the cycle reported no other position and the latched one lies on the cycle's
    path.
    """

    def __init__(
        self,
        conversation: Conversation,
        tracker: StatusTracker,
        motion: SerialMotion,
        frames: CoordinateFrames,
        controller_settings: ControllerSettings,
    ) -> None:
        self._conversation = conversation
        self._tracker = tracker
        self._motion = motion
        self._frames = frames
        self._settings = conversation.settings
        self._controller = controller_settings
        self._press_direction: Vector | None = None

    def touch_towards(self, target_mm: Vector, feed_mm_per_s: float) -> Touch | Miss:
        status = self._motion.require_ready()
        if status.deflected:
            raise CommandRejected(
                "the probe is deflected before the touch", hint="withdraw it first", **self._motion.where
            )
        goal = self._frames.to_machine(target_mm)
        if self._controller.stand_at(status.position_mm, goal):
            return Miss(_triple(self._frames.to_displayed(status.position_mm)))
        ended = self._cycle(UNTIL_CONTACT, "touch", status.position_mm, goal, feed_mm_per_s)
        position = _triple(self._frames.to_displayed(np.array(ended.result.position)))
        return Touch(position) if ended.result.tripped else Miss(position)

    def move_guarded(self, target_mm: Vector, feed_mm_per_s: float | None) -> None:
        """Move to the displayed axis position `target_mm`, and raise GuardTripped if the probe trips.

        If the probe is deflected at the start, the axes first move towards the target until the probe comes free.
        Raises CommandRejected if this would press the probe further.
        """
        status = self._motion.require_ready()
        goal = self._frames.to_machine(target_mm)
        if status.deflected:
            status = self._back_off(status, goal, feed_mm_per_s)
        start = status.position_mm
        if self._controller.stand_at(start, goal) or status.deflected:
            return
        ended = self._cycle(UNTIL_CONTACT, "guarded move", start, goal, self._feed(start, goal, feed_mm_per_s))
        if ended.result.tripped:
            x, y, z = self._frames.to_displayed(np.array(ended.result.position)).tolist()
            raise GuardTripped(
                f"the probe tripped in a move that was not a touch, at X {x:.3f} Y {y:.3f} Z {z:.3f}",
                hint="check for an obstacle, and that mount and artefact are where the plan expects them",
                **self._motion.where,
            )

    def _back_off(self, status: TrackedStatus, goal: Vector, feed_mm_per_s: float | None) -> TrackedStatus:
        """Move towards the goal until the probe comes free; return the status after the move.

        Raises CommandRejected if the move would press the probe further, MotionFault if the probe is still deflected
        after `release_distance_mm`. A shorter move that ends at the goal raises nothing.
        """
        start, path = status.position_mm, goal - status.position_mm
        length = float(np.linalg.norm(path))
        if self._controller.stand_at(start, goal):
            return status
        if self._press_direction is not None and float(path @ self._press_direction) > 0.0:
            raise CommandRejected(
                "the probe is deflected and the move would press it further", hint="move it free", **self._motion.where
            )
        share = min(1.0, self._settings.release_distance_mm / length)
        free_target = start + share * path
        ended = self._cycle(
            UNTIL_FREE, "move to free the probe", start, free_target, self._feed(start, free_target, feed_mm_per_s)
        )
        if ended.result.tripped:
            self._press_direction = None
        elif share < 1.0:
            raise MotionFault(
                f"the probe is still deflected after {self._settings.release_distance_mm:g} mm",
                hint="check the stylus and the probe's wiring ($6), and move it free by hand",
                **self._motion.where,
            )
        return ended.status

    def _cycle(self, code: str, what: str, start: Vector, goal: Vector, feed_mm_per_s: float) -> ProbeCycleResult:
        work = goal - self._tracker.work_offset()
        line = f"{PREAMBLE}{code}{axis_words(work)}{feed_word(feed_mm_per_s)}"
        order = MotionOrder(line, what, goal, feed_mm_per_s, self._settings.touch_poll_interval_s, barrier=False)
        try:
            status = self._motion.execute(order, start)
        except CommandRejected as rejected:
            return self._already_there(rejected, goal)
        results = self._conversation.probe_results
        if len(results) != 1:
            raise self._error(f"{what} ended with {len(results)} probe results, not one")
        result = results[0]
        if result.tripped:
            self._require_on_path(result, start, goal)
            if code == UNTIL_CONTACT:
                self._press_direction = (goal - start) / _distance(goal, start)
        else:
            self._motion.require_at(goal, status, what)
            if _distance(np.array(result.position), status.position_mm) > self._settings.position_tolerance_mm:
                raise self._error(f"{what} ended without a trip, but its result is not the position of the axes")
        return ProbeCycleResult(result, status)

    def _already_there(self, rejected: CommandRejected, goal: Vector) -> ProbeCycleResult:
        """Return the result of a cycle that was refused because the axes stand at its target; else raise `rejected`."""
        status = self._tracker.read_status()
        near = float(np.linalg.norm(status.position_mm - goal)) <= self._settings.position_tolerance_mm
        if rejected.where.get("error") != SAME_POSITION or not near:
            raise rejected
        return ProbeCycleResult(ProbeResult(_triple(status.position_mm), tripped=False), status)

    def _require_on_path(self, result: ProbeResult, start: Vector, goal: Vector) -> None:
        off_mm = distance_to_segment_mm(np.array(result.position), start, goal)
        allowed_mm = self._settings.latch_tolerance_mm
        if off_mm > allowed_mm:
            raise self._error(f"latched position is {off_mm:.3f} mm off the commanded path (allowed {allowed_mm:g} mm)")

    def _feed(self, start: Vector, goal: Vector, feed_mm_per_s: float | None) -> float:
        """Return the feed in mm/s of a probe cycle; if it is None (rapid), return the speed limit along the path.

        A probe cycle cannot run without a feed.
        """
        if feed_mm_per_s is not None:
            return feed_mm_per_s
        shares = (np.abs(goal - start) / _distance(goal, start)).tolist()
        return limit_along_direction(shares, self._frames.limits.rapid_mm_per_s)

    def _error(self, text: str) -> ProtocolError:
        return ProtocolError(
            text, hint="a line was lost or came twice: check cable, shield and baud", **self._motion.where
        )


def _distance(one: Vector, other: Vector) -> float:
    return float(np.linalg.norm(one - other))


def _triple(position: Vector) -> tuple[float, float, float]:
    x, y, z = position.tolist()
    return x, y, z
