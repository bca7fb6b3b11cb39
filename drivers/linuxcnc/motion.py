"""One straight motion by MDI, from the command to its end."""

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
from drivers.roles import MotionState, Permission, Vector
from drivers.straight_move import move_duration_s

DURATION_FACTOR = 1.5
"""A motion may take this many times its predicted duration, plus the margin."""
LIMIT_TOLERANCE_MM = 1e-6
REACHED_MM = 1e-4
"""LinuxCNC ends a motion exactly at its target; a text of six decimals and inches are coarser."""
REST_POLL_S = 0.01
PREFIX = "G21 G90 G94 G40"
OWN_CODES = (20.0, 21.0, 90.0, 91.0, 93.0, 94.0, 95.0)
"""Modal codes that the prefix changes and that are given back. Radius compensation is left off."""
TRIPPED = "robe tripped"
LEAST_OVERRIDE = 0.01
FREE_WITHIN_MM = 2.0
"""Less than any probe yields."""
FREEING_MM_PER_S = 2.0


class MotionKind(Enum):
    POSITIONING = "positioning move"
    GUARDED = "guarded move"
    TOUCH = "touch"


@dataclass(frozen=True)
class MotionResult:
    """Where a motion began, and the look that showed its end."""

    start: Triple
    snapshot: Snapshot


class LinuxCncMotion:
    """Starts motions and says how they ended. Whatever exception leaves a wait, the machine is stopped first."""

    def __init__(self, session: LinuxCncSession) -> None:
        self._session = session
        self._limits = session.properties.limits
        self._braking = False
        self._modal_before: tuple[float, ...] | None = None
        self._approach_direction: Triple | None = None  # the way of the last motion that began with the probe free
        self.tag = 0
        """Which step the motions belong to; written as a comment behind the line."""

    def run(self, kind: MotionKind, target_mm: Sequence[float], feed_mm_per_s: float | None) -> MotionResult:
        """Returns at the target, or for a touch where it tripped or ended; anything else is raised."""
        target = self._validated_target(kind, target_mm, feed_mm_per_s)
        self._await_rest()
        before = self._session.read_snapshot()
        self._require_ready(kind, before)
        before = self._ensure_probe_free(kind, before, target)
        if math.dist(before.position, target) < LIMIT_TOLERANCE_MM:
            return MotionResult(before.position, replace(before, tripped=False))
        self._modal_before = self._modal_before or before.modal
        ended = self._execute(kind, before, target, feed_mm_per_s)
        return MotionResult(before.position, ended)

    def stop(self) -> None:
        """Abort; does not wait for rest, since it is called where sleeping is not possible."""
        self._braking = True
        self._session.link.abort()

    def reset(self) -> None:
        """Switch the machine on where it is off, and wait until it says that it rests: for a few cycles more its task
        is still busy with switching on, and a motion would be refused."""
        if self._session.read_snapshot().task_state != ON:
            self._session.link.ask("on")
            self._await_rest(anyway=True)

    def require_idle(self) -> None:
        """CommandRejected while something moves or is held."""
        self._require_at_rest(self._session.read_snapshot())

    def restore_modes(self) -> None:
        """Restore the modal codes that were there before the first motion, and manual mode."""
        if self._modal_before is None or self._session.read_snapshot().task_state != ON:
            return
        self._await_rest()
        codes = " ".join(f"G{code:g}" for code in self._modal_before if code in OWN_CODES)
        self._session.link.ask("mdi", line=codes)
        self._await_rest(anyway=True)
        self._session.link.ask("mode", mode="manual")
        self._modal_before = None

    # ------------------------------------------------------------------ before

    def _validated_target(self, kind: MotionKind, target_mm: Sequence[float], feed_mm_per_s: float | None) -> Triple:
        x, y, z = (float(value) for value in target_mm)
        feed_ok = feed_mm_per_s is None or (math.isfinite(feed_mm_per_s) and feed_mm_per_s > 0.0)
        if not all(map(math.isfinite, (x, y, z))) or not feed_ok:
            raise self._rejected(f"{kind.value} to ({x}, {y}, {z}) with feed {feed_mm_per_s}: not a motion")
        for axis, value, low, high in zip(XYZ, (x, y, z), self._limits.lower_mm, self._limits.upper_mm, strict=True):
            if not low - LIMIT_TOLERANCE_MM <= value <= high + LIMIT_TOLERANCE_MM:
                raise self._rejected(f"{axis} {value:.3f} mm is outside {low:g} to {high:g} mm")
        return x, y, z

    def _await_rest(self, *, anyway: bool = False) -> None:
        """After an abort the axes brake for a moment, in which LinuxCNC would refuse a motion."""
        if not (self._braking or anyway):
            return
        session = self._session
        deadline = Deadline.after(session.clock, session.settings.motion_margin_s)
        while session.read_snapshot().state is MotionState.MOVING:
            deadline.raise_if_expired("the axes to rest", hint="see LinuxCNC", **session.where)
            session.clock.sleep(REST_POLL_S)
        self._braking = False

    def _require_ready(self, kind: MotionKind, before: Snapshot) -> None:
        session = self._session
        missing = [name for name, given in session.permissions(before).items() if not given]
        if Permission.REFERENCED in missing:
            raise PermissionMissing(
                "the joints are not homed", hint="home them at the machine, or see option homing", **session.where
            )
        if missing:
            names = ", ".join(name.value for name in missing)
            fault = f" ({before.fault})" if before.fault else ""
            raise PermissionMissing(f"no {kind.value} is permitted; missing: {names}{fault}", **session.where)
        self._require_at_rest(before)
        if before.rotation_deg != 0.0:
            raise self._rejected(
                f"the work coordinate system is rotated by {before.rotation_deg:g}°", hint="G10 L2 P0 R0"
            )

    def _require_at_rest(self, snapshot: Snapshot) -> None:
        if snapshot.state is not MotionState.IDLE:
            raise self._rejected(f"LinuxCNC is {snapshot.state.value}", hint="end the program or the hold first")

    def _ensure_probe_free(self, kind: MotionKind, before: Snapshot, target: Triple) -> Snapshot:
        """LinuxCNC sees only the edge of the probe's signal, so a probe that is deflected guards nothing. It may be
        led back against the way it came; where that is not known, it is led a little and must come free."""
        if kind is MotionKind.POSITIONING or not before.deflected:
            return before
        if kind is MotionKind.TOUCH:
            raise self._rejected("the probe is deflected before the touch", hint="back off first")
        path = np.subtract(target, before.position)
        if self._approach_direction is None:
            return self._free_slowly(before, path)
        if float(path @ np.array(self._approach_direction)) >= 0.0:
            raise self._rejected("the probe is deflected and the move would not lead it back", hint="move it free")
        return before

    def _free_slowly(self, before: Snapshot, path: Vector) -> Snapshot:
        """Where the first millimetres of a move end, slowly; GuardTripped where the probe is still deflected there."""
        length = float(np.linalg.norm(path))
        if length < LIMIT_TOLERANCE_MM:
            return before
        x, y, z = (np.array(before.position) + path * min(1.0, FREE_WITHIN_MM / length)).tolist()
        self._modal_before = self._modal_before or before.modal
        ended = self._execute(MotionKind.POSITIONING, before, (x, y, z), FREEING_MM_PER_S)
        if ended.deflected:
            raise GuardTripped(
                f"the probe is deflected, and still is after {FREE_WITHIN_MM:g} mm of this move",
                hint="move it free by hand",
                **self._session.where,
            )
        return ended

    def _line(self, kind: MotionKind, before: Snapshot, target: Triple, feed_mm_per_s: float | None) -> str:
        """Machine positions by G53; G38 knows no G53, so the offsets that act are taken off."""
        if kind is MotionKind.TOUCH:
            target = _difference(target, before.program_offset)
        words = " ".join(f"{axis}{value:.7f}" for axis, value in zip(XYZ, target, strict=True))
        word = "G38.3" if kind is MotionKind.TOUCH else ("G53 G0" if feed_mm_per_s is None else "G53 G1")
        feed = "" if feed_mm_per_s is None else f" F{60.0 * feed_mm_per_s:.6f}"
        comment = f" (volcal {self.tag})" if self.tag else ""
        return f"{PREFIX} {word} {words}{feed}{comment}"

    # ------------------------------------------------------------------ while

    def _execute(self, kind: MotionKind, before: Snapshot, target: Triple, feed_mm_per_s: float | None) -> Snapshot:
        """The look that shows its end, which was a success."""
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
        self._require_success(kind, ended, target, messages)
        return ended

    def _wait(
        self, kind: MotionKind, before: Snapshot, target: Triple, feed_mm_per_s: float | None
    ) -> tuple[Snapshot, tuple[str, ...]]:
        """The look that shows the axes at rest, with what came of the motion when it ended, and all that LinuxCNC has
        said meanwhile: after a trip it is done with a move while the axes still brake."""
        session, clock, settings = self._session, self._session.clock, self._session.settings
        allowed_s = self._allowed_s(before, target, feed_mm_per_s)
        deadline = Deadline.after(clock, allowed_s)
        held: Deadline | None = None
        messages: tuple[str, ...] = ()
        ended: Snapshot | None = None
        while True:
            snapshot = session.read_snapshot()
            messages += snapshot.errors
            if not snapshot.under_way or snapshot.task_state != ON:
                ended = replace(snapshot, outcome=(ended or snapshot).outcome)
                if snapshot.in_position or snapshot.task_state != ON:
                    return ended, messages + self._late_messages(ended, messages)
            self._require_still_permitted(kind, snapshot)
            if snapshot.paused:
                held = held or Deadline.after(clock, settings.held_at_most_s)
                self._require_resumed(held)
                deadline = Deadline.after(clock, allowed_s)
            else:
                held = None
                deadline.raise_if_expired(f"the end of a {kind.value}", hint="see LinuxCNC", **session.where)
            clock.sleep(settings.poll_interval_s)

    def _late_messages(self, ended: Snapshot, messages: tuple[str, ...]) -> tuple[str, ...]:
        """The reason of an error may come a cycle after it."""
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
        return DURATION_FACTOR * predicted_s / max(min(override, 1.0), LEAST_OVERRIDE) + (
            self._session.settings.motion_margin_s
        )

    def _require_still_permitted(self, kind: MotionKind, snapshot: Snapshot) -> None:
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
                f"motion held at the machine for more than {self._session.settings.held_at_most_s:g} s",
                hint="release the hold and start the run again",
                **self._session.where,
            )

    def _stop_because_of(self, error: BaseException) -> None:
        try:
            self.stop()
        except DeviceError as failure:
            error.add_note(f"the abort after this failed: {failure}")

    # ------------------------------------------------------------------ after

    def _require_success(self, kind: MotionKind, ended: Snapshot, target: Triple, messages: tuple[str, ...]) -> None:
        where = self._session.where
        text = "; ".join(messages)
        if ended.task_state != ON:
            raise MotionFault(
                f"{kind.value} ended in a fault: {ended.fault}{': ' if text else ''}{text}",
                hint="clear the cause and switch the machine on",
                **where,
            )
        if ended.abandoned:
            raise MotionFault(f"the bridge stopped a {kind.value}: nobody had asked after it", **where)
        if kind is MotionKind.TOUCH and ended.tripped:
            return
        if TRIPPED in text:
            raise self._guard_tripped(kind, ended)
        if ended.outcome == "error":
            raise self._rejected(
                f"LinuxCNC refused a {kind.value}: {text or 'it gives no reason'}",
                hint="" if text else "motion did not answer its task in time? See [EMCMOT]COMM_TIMEOUT",
            )
        if math.dist(ended.position, target) > REACHED_MM:
            raise MotionFault(
                f"{kind.value} was stopped at the machine{': ' if text else ''}{text}",
                hint="start the run again",
                **where,
            )

    def _guard_tripped(self, kind: MotionKind, ended: Snapshot) -> MotionFault:
        """LinuxCNC has stopped and is ready again: the way back is open."""
        x, y, z = ended.position
        fault = GuardTripped if kind is MotionKind.GUARDED else MotionFault
        return fault(
            f"probe tripped in a move that was no touch, near X {x:.3f} Y {y:.3f} Z {z:.3f}",
            hint="something stands in the way, or mount and artefact are not where the plan has them",
            **self._session.where,
        )

    def _rejected(self, text: str, hint: str = "") -> CommandRejected:
        return CommandRejected(text, hint=hint, **self._session.where)


def _difference(minuend: Triple, subtrahend: Triple) -> Triple:
    x, y, z = (a - b for a, b in zip(minuend, subtrahend, strict=True))
    return x, y, z
