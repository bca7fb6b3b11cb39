"""Motion commands to a Modbus controller, followed from their acceptance to the outcome of the motion."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

from drivers.clock import Deadline
from drivers.errors import (
    CommandRejected,
    DeviceError,
    GuardTripped,
    MotionFault,
    PermissionMissing,
    ProtocolError,
)
from drivers.modbus_cnc.codes import (
    FAULT_GUARD_TRIPPED,
    PERMISSION_FAULTS,
    CommandCode,
    MotionOutcome,
    fault_text,
)
from drivers.modbus_cnc.registers import CommandBlock, StatusImage, Triple
from drivers.modbus_cnc.session import ModbusSession
from drivers.roles import AxisLimits, MotionState
from drivers.straight_move import move_duration_s

COARSEST_FINE_POLL_S = 0.1
END_MARGIN_S = 0.001
"""Time in s between the predicted end and the poll for it; a poll exactly at that end would often be too early."""

DURATION_FACTOR = 1.5
"""Ratio of a motion's time limit to its predicted duration, before `motion_margin_s` is added.

It allows for feed override and look-ahead.
"""


class ModbusMotionResult(NamedTuple):
    """Result of a motion: its start position in mm, and the status image (contents of the controller's status block)
    that shows its outcome.
    """

    start: Triple
    status: StatusImage


class ModbusMotion:
    """Executor of motions on a Modbus controller.

    It starts a motion, renews the driver's heartbeat (a counter that the controller monitors) until the motion ends,
    and returns the result.

    If an exception interrupts the wait for the end, the command STOP is sent before the exception propagates.
    """

    def __init__(self, session: ModbusSession, limits: AxisLimits) -> None:
        self._session = session
        self._limits = limits
        self._braking = False
        self.tag = 0
        """Tag of the step to which the motions belong. It is sent in the CRC field, which motions do not use."""

    def run(self, code: CommandCode, target_mm: Sequence[float], feed_mm_per_s: float | None) -> ModbusMotionResult:
        """Carry out a motion and return its result.

        A touch ends with a trip or a miss, and any other motion ends with the axes in position. Every other outcome
        raises a DeviceError.
        """
        session = self._session
        target = self._validated_target(code, target_mm, feed_mm_per_s)
        try:
            self._await_rest()
            sequence, accepted = session.start(
                CommandBlock(code, crc=self.tag, target=target, feed=feed_mm_per_s or 0.0)
            )
            status = self._wait(code, target, feed_mm_per_s, accepted)
        except BaseException as error:
            self._stop_because_of(error)
            raise
        if status.motion_sequence != sequence:
            raise self._protocol_error(f"started motion {sequence}, but motion {status.motion_sequence} ended")
        self._require_success(code, status)
        return ModbusMotionResult(accepted.position, status)

    def stop(self) -> None:
        """Send the command STOP and return before the axes are at rest.

        The method does not wait for standstill because it may be called from inside a sleep of the clock.
        """
        self._braking = True
        self._session.send_urgent(CommandCode.STOP)

    def _await_rest(self) -> None:
        """Wait until the axes have come to rest after a STOP; the controller refuses motions while they brake."""
        if not self._braking:
            return
        session = self._session
        deadline = Deadline.after(session.clock, session.settings.motion_margin_s)
        while _is_under_way(session.poll()):
            deadline.raise_if_expired(
                "the axes to come to rest after STOP", hint="check the controller", **session.where
            )
            session.clock.sleep(session.settings.fine_poll_interval_s)
        self._braking = False

    def _validated_target(self, code: CommandCode, target_mm: Sequence[float], feed_mm_per_s: float | None) -> Triple:
        x, y, z = (float(value) for value in target_mm)
        feed_ok = feed_mm_per_s is None or (math.isfinite(feed_mm_per_s) and feed_mm_per_s > 0.0)
        if not all(map(math.isfinite, (x, y, z))) or not feed_ok:
            raise CommandRejected(
                f"{code.label} to ({x}, {y}, {z}) with feed {feed_mm_per_s}: not a motion",
                **self._session.where,
            )
        return x, y, z

    def _wait(self, code: CommandCode, target: Triple, feed_mm_per_s: float | None, status: StatusImage) -> StatusImage:
        session, clock, settings = self._session, self._session.clock, self._session.settings
        predicted_s = self._predicted_s(status.position, target, feed_mm_per_s)
        slice_s = self._slice_s(
            settings.touch_poll_interval_s if code is CommandCode.TOUCH else settings.poll_interval_s
        )
        end_s = clock.now() + predicted_s + END_MARGIN_S
        allowed_s = DURATION_FACTOR * predicted_s + settings.motion_margin_s
        deadline = Deadline.after(clock, allowed_s)
        held_deadline: Deadline | None = None
        fine_s = settings.fine_poll_interval_s
        while _is_under_way(status):
            if status.state is MotionState.HELD:
                held_deadline = held_deadline or Deadline.after(clock, settings.max_hold_s)
                self._require_resumed(held_deadline)
                deadline = Deadline.after(clock, allowed_s)
                pause_s = slice_s
            else:
                held_deadline = None
                deadline.raise_if_expired(f"the end of {code.label}", hint="check the controller", **session.where)
                pause_s = _equal_slice_s(end_s - clock.now(), slice_s)
                if pause_s < fine_s:
                    pause_s, fine_s = fine_s, min(1.5 * fine_s, COARSEST_FINE_POLL_S, slice_s)
            clock.sleep(pause_s)
            status = session.poll()
        return status

    def _slice_s(self, interval_s: float) -> float:
        """Return the pause in s between polls: the interval minus a poll's transmission time, with a lower bound."""
        return max(interval_s - self._session.poll_wire_time_s, self._session.settings.fine_poll_interval_s)

    def _predicted_s(self, start: Triple, target: Triple, feed_mm_per_s: float | None) -> float:
        return move_duration_s(
            start,
            target,
            feed_mm_per_s=feed_mm_per_s,
            rapid_mm_per_s=self._limits.rapid_mm_per_s,
            acceleration_mm_per_s2=self._limits.acceleration_mm_per_s2,
        )

    def _require_resumed(self, held_deadline: Deadline) -> None:
        if held_deadline.expired:
            raise MotionFault(
                f"motion held at the machine for more than {self._session.settings.max_hold_s:g} s",
                hint="release the feed hold and start the run again",
                **self._session.where,
            )

    def _stop_because_of(self, error: BaseException) -> None:
        try:
            if self._session.link.connected:
                self.stop()
        except DeviceError as failure:
            error.add_note(f"STOP after this failed: {failure}")

    def _require_success(self, code: CommandCode, status: StatusImage) -> None:
        expected = (
            (MotionOutcome.TRIPPED, MotionOutcome.MISSED) if code is CommandCode.TOUCH else (MotionOutcome.IN_POSITION,)
        )
        if status.outcome not in expected:
            raise self._failure(code, status)

    def _failure(self, code: CommandCode, status: StatusImage) -> DeviceError:
        where = self._session.where
        if status.outcome is MotionOutcome.GUARD_TRIPPED:
            return self._guard_tripped(status)
        if status.outcome is MotionOutcome.STOPPED:
            return MotionFault(f"{code.label} was stopped at the machine", hint="start the run again", **where)
        if status.state is MotionState.FAULT:
            missing = [name.value for name, given in status.permissions.items() if not given]
            text = f"{code.label} ended in a fault: {fault_text(status.fault_code) or 'no fault code'}"
            if status.fault_code in PERMISSION_FAULTS:
                lost = ", ".join(missing) or "none any more"
                return PermissionMissing(f"{text}; missing: {lost}", hint="make the machine ready", **where)
            return MotionFault(text, hint="clear the cause and reset the controller", **where)
        return self._protocol_error(f"{code.label} ended with outcome {status.outcome.name}")

    def _guard_tripped(self, status: StatusImage) -> GuardTripped:
        """Return the error for a trip in a guarded move; clear the fault so that the probe can be withdrawn."""
        x, y, z = status.position
        error = GuardTripped(
            f"the probe tripped in a move that was not a touch, near X {x:.3f} Y {y:.3f} Z {z:.3f}",
            hint="check for an obstacle, and that mount and artefact are where the plan expects them",
            **self._session.where,
        )
        if status.fault_code == FAULT_GUARD_TRIPPED:
            try:
                self._session.command(CommandBlock(CommandCode.RESET))
            except DeviceError as failure:
                error.add_note(f"RESET after this failed: {failure}")
        return error

    def _protocol_error(self, text: str) -> ProtocolError:
        return ProtocolError(text, hint="the controller does not follow the register map", **self._session.where)


def _is_under_way(status: StatusImage) -> bool:
    return status.outcome is MotionOutcome.UNDER_WAY and status.state is not MotionState.FAULT


def _equal_slice_s(remaining_s: float, slice_s: float) -> float:
    """Return the length in s of equal parts of the remaining time, each at most `slice_s`."""
    return remaining_s / math.ceil(remaining_s / slice_s) if remaining_s > 0.0 else 0.0
