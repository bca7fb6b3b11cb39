"""Straight motions of a LinuxCNC machine. Each motion is commanded by one MDI line and followed until its end."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import Enum

import numpy as np

from drivers.clock import Deadline
from drivers.errors import (
    CommandRejected,
    DeviceError,
    GuardTripped,
    LinkError,
    MotionFault,
    PermissionMissing,
)
from drivers.linuxcnc.session import XYZ, LinuxCncSession
from drivers.linuxcnc.snapshot import ON, Snapshot, Triple
from drivers.motion_deadline import MotionDeadline
from drivers.reached_position import require_reached
from drivers.roles import MotionState, Permission, Vector
from drivers.straight_move import move_duration_s

DURATION_FACTOR = 1.5
"""Ratio of a motion's time limit to its predicted duration, before `motion_margin_s` is added."""
LIMIT_TOLERANCE_MM = 1e-6
REST_POLL_S = 0.01
PREFIX = "G21 G90 G94 G40"
OWN_CODES = (20.0, 21.0, 90.0, 91.0, 93.0, 94.0, 95.0)
"""Codes of the modal groups that the motions change; codes active before the first motion are restored later.

Cutter radius compensation, which `PREFIX` switches off, is not restored.
"""
TRIP_MESSAGE_PART = "robe tripped"
"""Text that all of LinuxCNC's messages about a trip in a move contain.

Its first letter is omitted, because the messages differ in its case.
"""
MIN_OVERRIDE = 0.01
FREE_WITHIN_MM = 2.0
"""Longest path in mm for moving the probe free; less than the overtravel of any probe."""
FREEING_MM_PER_S = 2.0


class MdiMotionKind(Enum):
    POSITIONING = "positioning move"
    GUARDED = "guarded move"
    TOUCH = "touch"


@dataclass(frozen=True)
class LinuxCncMotionResult:
    """Result of a motion: its start position, and the snapshot of LinuxCNC at its end."""

    start: Triple
    snapshot: Snapshot


class LinuxCncMotion:
    """Straight motions of the machine.

    If an exception ends the wait for the end of a motion, the machine is stopped before the exception propagates.
    """

    def __init__(self, session: LinuxCncSession) -> None:
        self._session = session
        self._limits = session.properties.limits
        self._braking = False
        self._modal_before: tuple[float, ...] | None = None
        self._approach_direction: Triple | None = None  # path of the last motion begun with a free probe
        self.tag = 0
        """Tag of the step to which the motions belong. It is appended to the MDI line as a comment."""

    def run(self, kind: MdiMotionKind, target_mm: Sequence[float], feed_mm_per_s: float | None) -> LinuxCncMotionResult:
        """Move along a straight line until `target_mm` is reached or, in a touch, until the probe trips.

        Raises an error if the motion ends in any other way.
        """
        target = self._validated_target(kind, target_mm, feed_mm_per_s)
        self._await_rest()
        before = self._session.read_snapshot()
        self._require_ready(kind, before)
        before = self._ensure_probe_free(kind, before, target)
        if math.dist(before.position, target) < LIMIT_TOLERANCE_MM:
            return LinuxCncMotionResult(before.position, replace(before, tripped=False))
        self._modal_before = self._modal_before or before.modal
        ended = self._execute(kind, before, target, feed_mm_per_s)
        return LinuxCncMotionResult(before.position, ended)

    def stop(self) -> None:
        """Stop the motion in progress without waiting for standstill.

        The method must not wait, because it may be called while a sleep of the clock is being interrupted.
        """
        self._braking = True
        self._session.link.abort()

    def reset(self) -> None:
        """Switch the machine on if it is off or held by volcal, and wait until LinuxCNC reports that it is idle.

        Without the wait, LinuxCNC would refuse a motion for a few cycles after the machine is switched on.
        """
        snapshot = self._session.read_snapshot()
        if snapshot.task_state != ON or snapshot.held_by_volcal:
            self._session.link.ask("on")
            self._await_rest(anyway=True)

    def require_idle(self) -> None:
        """Raise CommandRejected if a motion of the machine is in progress or paused (held)."""
        self._require_at_rest(self._session.read_snapshot())

    def restore_modes(self) -> None:
        """Restore the modal G-codes that were in effect before the first motion, and switch to manual mode.

        The method has no effect if no motion was made or if the machine is off.
        """
        if self._modal_before is None or self._session.read_snapshot().task_state != ON:
            return
        self._await_rest()
        codes = " ".join(f"G{code:g}" for code in self._modal_before if code in OWN_CODES)
        self._session.link.ask("mdi", line=codes)
        self._await_rest(anyway=True)
        self._session.link.ask("mode", mode="manual")
        self._modal_before = None

    # ------------------------------------------------------------------ before

    def _validated_target(self, kind: MdiMotionKind, target_mm: Sequence[float], feed_mm_per_s: float | None) -> Triple:
        x, y, z = (float(value) for value in target_mm)
        feed_ok = feed_mm_per_s is None or (math.isfinite(feed_mm_per_s) and feed_mm_per_s > 0.0)
        if not all(map(math.isfinite, (x, y, z))) or not feed_ok:
            raise self._rejected(f"{kind.value} to ({x}, {y}, {z}) with feed {feed_mm_per_s}: not a motion")
        for axis, value, low, high in zip(XYZ, (x, y, z), self._limits.lower_mm, self._limits.upper_mm, strict=True):
            if not low - LIMIT_TOLERANCE_MM <= value <= high + LIMIT_TOLERANCE_MM:
                raise self._rejected(f"{axis} {value:.3f} mm is outside {low:g} to {high:g} mm")
        return x, y, z

    def _await_rest(self, *, anyway: bool = False) -> None:
        """Wait until the axes have come to rest after an abort; LinuxCNC refuses motions while they brake."""
        if not (self._braking or anyway):
            return
        session = self._session
        deadline = Deadline.after(session.clock, session.settings.motion_margin_s)
        while session.read_snapshot().state is MotionState.MOVING:
            deadline.raise_if_expired("the axes to come to rest", hint="check LinuxCNC", **session.where)
            session.clock.sleep(REST_POLL_S)
        self._braking = False

    def _require_ready(self, kind: MdiMotionKind, before: Snapshot) -> None:
        session = self._session
        missing = [name for name, given in session.permissions(before).items() if not given]
        if Permission.REFERENCED in missing:
            raise PermissionMissing(
                "the joints are not homed", hint="home them at the machine, or see option homing", **session.where
            )
        if missing:
            names = ", ".join(name.value for name in missing)
            fault = f" ({before.fault})" if before.fault else ""
            raise PermissionMissing(
                f"a {kind.value} is not permitted; missing: {names}{fault}",
                hint="make the machine ready",
                **session.where,
            )
        self._require_at_rest(before)
        if before.rotation_deg != 0.0:
            raise self._rejected(
                f"the work coordinate system is rotated by {before.rotation_deg:g}°",
                hint="remove the rotation with G10 L2 P0 R0",
            )

    def _require_at_rest(self, snapshot: Snapshot) -> None:
        if snapshot.state is not MotionState.IDLE:
            raise self._rejected(f"LinuxCNC is {snapshot.state.value}", hint="end the program or the hold first")

    def _ensure_probe_free(self, kind: MdiMotionKind, before: Snapshot, target: Triple) -> Snapshot:
        """Ensure that the probe is free or that the motion withdraws it; return a snapshot of the state to start from.

        LinuxCNC evaluates only the edge of the probe signal, so a deflected probe does not guard a motion. Such a probe
        may be moved only against its approach direction. If that direction is unknown, the probe is first moved a short
        distance along the path, after which it must be free.
        """
        if kind is MdiMotionKind.POSITIONING or not before.deflected:
            return before
        if kind is MdiMotionKind.TOUCH:
            raise self._rejected("the probe is deflected before the touch", hint="withdraw it first")
        path = np.subtract(target, before.position)
        if self._approach_direction is None:
            return self._free_slowly(before, path)
        if float(path @ np.array(self._approach_direction)) >= 0.0:
            raise self._rejected("the probe is deflected, and the move would not withdraw it", hint="move it free")
        return before

    def _free_slowly(self, before: Snapshot, path: Vector) -> Snapshot:
        """Move slowly along the first `FREE_WITHIN_MM` of the path and return the snapshot at the end of that move.

        Raises GuardTripped if the probe is still deflected.
        """
        length = float(np.linalg.norm(path))
        if length < LIMIT_TOLERANCE_MM:
            return before
        x, y, z = (np.array(before.position) + path * min(1.0, FREE_WITHIN_MM / length)).tolist()
        self._modal_before = self._modal_before or before.modal
        ended = self._execute(MdiMotionKind.POSITIONING, before, (x, y, z), FREEING_MM_PER_S)
        if ended.deflected:
            raise GuardTripped(
                f"the probe is still deflected after {FREE_WITHIN_MM:g} mm of this move",
                hint="move it free by hand",
                **self._session.where,
            )
        return ended

    def _line(self, kind: MdiMotionKind, before: Snapshot, target: Triple, feed_mm_per_s: float | None) -> str:
        """Return the MDI line of the motion.

        Targets are machine positions, given with G53. G38 does not support G53, so for a touch the active offsets are
        subtracted from the target.
        """
        if kind is MdiMotionKind.TOUCH:
            target = _difference(target, before.program_offset)
        words = " ".join(f"{axis}{value:.7f}" for axis, value in zip(XYZ, target, strict=True))
        word = "G38.3" if kind is MdiMotionKind.TOUCH else ("G53 G0" if feed_mm_per_s is None else "G53 G1")
        feed = "" if feed_mm_per_s is None else f" F{60.0 * feed_mm_per_s:.6f}"
        comment = f" (volcal {self.tag})" if self.tag else ""
        return f"{PREFIX} {word} {words}{feed}{comment}"

    # ------------------------------------------------------------------ during

    def _execute(self, kind: MdiMotionKind, before: Snapshot, target: Triple, feed_mm_per_s: float | None) -> Snapshot:
        """Carry out the motion and return the snapshot at its successful end."""
        if not before.deflected:
            self._approach_direction = _difference(target, before.position)
        try:
            self._session.link.ask("mdi", line=self._line(kind, before, target, feed_mm_per_s))
        except LinkError as error:
            self._stop_because_of(error)
            raise
        try:
            ended, messages = self._wait(kind, before, target, feed_mm_per_s)
        except BaseException as error:
            self._stop_because_of(error)
            raise
        self._require_success(kind, before.position, ended, target, messages)
        return ended

    def _wait(
        self, kind: MdiMotionKind, before: Snapshot, target: Triple, feed_mm_per_s: float | None
    ) -> tuple[Snapshot, tuple[str, ...]]:
        """Wait for the end of a motion; return a snapshot and LinuxCNC's messages during the motion.

        In the returned snapshot the axes are at rest or the machine is off. Its outcome is copied from the first
        snapshot after the end of the motion command, since after a trip LinuxCNC ends the command while the axes are
        still braking.
        """
        session, clock, settings = self._session, self._session.clock, self._session.settings
        deadline = MotionDeadline(
            clock,
            target,
            before.position,
            allowed_s=self._allowed_s(before, target, feed_mm_per_s),
            stall_s=settings.motion_margin_s,
        )
        held: Deadline | None = None
        messages: tuple[str, ...] = ()
        ended: Snapshot | None = None
        while True:
            snapshot = session.read_snapshot()
            messages += snapshot.errors
            deadline.observe(snapshot.position)
            if not snapshot.under_way or snapshot.fault:
                ended = replace(snapshot, outcome=(ended or snapshot).outcome)
                if snapshot.in_position or snapshot.fault:
                    return ended, messages + self._late_messages(ended, messages)
            self._require_still_permitted(kind, snapshot)
            if snapshot.paused:
                held = held or Deadline.after(clock, settings.max_hold_s)
                self._require_resumed(held)
                deadline.restart()
            else:
                held = None
                deadline.raise_if_expired(kind.value, session.where)
            clock.sleep(settings.poll_interval_s)

    def _late_messages(self, ended: Snapshot, messages: tuple[str, ...]) -> tuple[str, ...]:
        """Return the messages that arrive up to one poll after an error.

        Returns none if there was no error, or if `messages` is not empty.
        """
        if ended.outcome != "error" or messages:
            return ()
        self._session.clock.sleep(self._session.settings.poll_interval_s)
        return self._session.read_snapshot().errors

    def _allowed_s(self, before: Snapshot, target: Triple, feed_mm_per_s: float | None) -> float:
        override = before.rapid_override if feed_mm_per_s is None else before.feed_override
        predicted_s = move_duration_s(
            before.position,
            target,
            feed_mm_per_s=feed_mm_per_s,
            rapid_mm_per_s=self._limits.rapid_mm_per_s,
            acceleration_mm_per_s2=self._limits.acceleration_mm_per_s2,
        )
        return DURATION_FACTOR * predicted_s / max(min(override, 1.0), MIN_OVERRIDE) + (
            self._session.settings.motion_margin_s
        )

    def _require_still_permitted(self, kind: MdiMotionKind, snapshot: Snapshot) -> None:
        given = self._session.permissions(snapshot)
        missing = [name.value for name, present in given.items() if not present]
        if missing:
            raise PermissionMissing(
                f"{kind.value} stopped; missing: {', '.join(missing)}",
                hint="make the machine ready",
                **self._session.where,
            )

    def _require_resumed(self, held: Deadline) -> None:
        if held.expired:
            raise MotionFault(
                f"motion held at the machine for more than {self._session.settings.max_hold_s:g} s",
                hint="release the hold and start the run again",
                **self._session.where,
            )

    def _stop_because_of(self, error: BaseException) -> None:
        try:
            self.stop()
        except DeviceError as failure:
            error.add_note(f"the abort after this failed: {failure}")

    # ------------------------------------------------------------------ after

    def _require_success(
        self, kind: MdiMotionKind, start: Triple, ended: Snapshot, target: Triple, messages: tuple[str, ...]
    ) -> None:
        where = self._session.where
        text = "; ".join(messages)
        if ended.fault:
            raise MotionFault(
                f"{kind.value} ended in a fault: {ended.fault}{': ' if text else ''}{text}",
                hint="clear the cause and switch the machine on",
                **where,
            )
        if ended.abandoned:
            raise MotionFault(f"the bridge stopped a {kind.value}: no status query came in time", **where)
        if kind is MdiMotionKind.TOUCH and ended.tripped and self._has_come_to_latch(start, ended, target):
            return
        if TRIP_MESSAGE_PART in text:
            raise self._guard_tripped(kind, ended)
        if ended.outcome == "error":
            raise self._rejected(
                f"LinuxCNC refused a {kind.value}: {text or 'it gives no reason'}",
                hint="" if text else "motion may not have answered its task in time; see [EMCMOT]COMM_TIMEOUT",
            )
        what = f"{kind.value} ({text or 'probably stopped at the machine'})"
        require_reached(ended.position, target, self._session.settings.position_tolerance_mm, what, where)

    def _has_come_to_latch(self, start: Triple, ended: Snapshot, target: Triple) -> bool:
        """Return True if the axes have travelled as far as the latched position.

        LinuxCNC clears its flag of a trip only when it begins a touch. If it refuses the touch, or a person stops it
        before it begins, the flag and the latched position are those of an earlier touch.
        """
        path = np.subtract(target, start)
        beyond_mm = float(np.subtract(ended.position, ended.probed) @ path) / float(np.linalg.norm(path))
        return beyond_mm >= -self._session.settings.position_tolerance_mm

    def _guard_tripped(self, kind: MdiMotionKind, ended: Snapshot) -> MotionFault:
        """Return the error for a trip in a move. LinuxCNC has stopped and is ready again, so no reset is needed."""
        x, y, z = ended.position
        fault = GuardTripped if kind is MdiMotionKind.GUARDED else MotionFault
        return fault(
            f"the probe tripped in a move that was not a touch, near X {x:.3f} Y {y:.3f} Z {z:.3f}",
            hint="check for an obstacle, and that mount and artefact are where the plan expects them",
            **self._session.where,
        )

    def _rejected(self, text: str, hint: str = "") -> CommandRejected:
        return CommandRejected(text, hint=hint, **self._session.where)


def _difference(minuend: Triple, subtrahend: Triple) -> Triple:
    x, y, z = (a - b for a, b in zip(minuend, subtrahend, strict=True))
    return x, y, z
