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
    LinkLost,
    MotionFault,
    PermissionMissing,
    ProtocolError,
)
from drivers.links.reconnection import LINK_FAILURES
from drivers.modbus_cnc.codes import (
    FAULT_GUARD_TRIPPED,
    OUTSIDE_TRAVEL,
    PERMISSION_FAULTS,
    CommandCode,
    MotionOutcome,
    fault_text,
)
from drivers.modbus_cnc.registers import CommandBlock, StatusImage, Triple
from drivers.modbus_cnc.session import ModbusSession
from drivers.motion_deadline import MotionDeadline
from drivers.reached_position import require_reached
from drivers.roles import AxisLimits, MotionState
from drivers.straight_move import move_duration_s, touch_duration_s

COARSEST_FINE_POLL_S = 0.1
END_MARGIN_S = 0.001
"""Time in s between the predicted end and the poll for it; a poll exactly at that end would often be too early."""

DURATION_FACTOR = 1.5
"""Ratio of a motion's time limit to its predicted duration, before `motion_margin_s` is added.

It allows for look-ahead; at a reduced feed override, the limit is extended as long as the axes advance.
"""


class ModbusMotionResult(NamedTuple):
    """Result of a motion: its start position in mm, and the status image that shows its outcome."""

    start: Triple
    status: StatusImage


class ModbusMotion:
    """Executor of motions on a Modbus controller.

    It starts a motion, renews the driver's heartbeat until the motion ends, and returns the result.

    If an exception interrupts the wait for the end, the command STOP is sent before the exception propagates.
    """

    def __init__(self, session: ModbusSession, limits: AxisLimits) -> None:
        self._session = session
        self._limits = limits
        self._braking = False
        self._trips_mm: dict[float, float] = {}
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
            sequence, accepted = self._start(code, target, feed_mm_per_s)
            with session.reconnection.suspended():
                status = self._wait(code, target, feed_mm_per_s, accepted)
        except BaseException as error:
            self._stop_because_of(error)
            raise
        try:
            self._require_own_outcome(sequence, status)
            self._require_success(code, status)
            self._require_reached(code, target, status)
        except DeviceError as error:
            if status.state is MotionState.MOVING:  # what the controller says of the end is not true
                self._stop_because_of(error)
            raise
        if status.outcome is MotionOutcome.TRIPPED:
            self._trips_mm[_rounded_length(accepted.position, target)] = math.dist(accepted.position, status.latched)
        return ModbusMotionResult(accepted.position, status)

    def _require_own_outcome(self, sequence: int, status: StatusImage) -> None:
        if status.motion_sequence == 0:
            raise MotionFault(
                f"the controller has forgotten motion {sequence}, which it had begun: it was restarted",
                hint="reference the axes, then continue with `volcal resume`",
                **self._session.where,
            )
        if status.motion_sequence != sequence:
            raise self._protocol_error(f"started motion {sequence}, but motion {status.motion_sequence} ended")

    def _start(self, code: CommandCode, target: Triple, feed_mm_per_s: float | None) -> tuple[int, StatusImage]:
        """Send a motion command and return its sequence number and the status after its acknowledgement.

        If the link was interrupted in between and the axes are now moving, the motion is not followed further: raises
        LinkLost, and the caller stops it.
        """
        session = self._session
        command = CommandBlock(code, crc=self.tag, target=target, feed=feed_mm_per_s or 0.0)
        try:
            sequence, accepted = session.start(command)
        except CommandRejected as refusal:
            if refusal.where.get("result") == str(OUTSIDE_TRAVEL) and self._is_within_travel(target):
                refusal.hint = (
                    "the target lies within the travel that the controller states: compare its software limits, and "
                    "the word order in which it reads the target"
                )
            raise
        if session.interrupted_since_command and _is_under_way(accepted):
            raise LinkLost(
                f"the link was interrupted while {code.label} was sent, and the axes have begun to move",
                hint="the motion was stopped; continue with `volcal resume`",
                **session.where,
            )
        return sequence, accepted

    def _is_within_travel(self, target: Triple) -> bool:
        limits = zip(self._limits.lower_mm, target, self._limits.upper_mm, strict=True)
        return all(low <= value <= high for low, value, high in limits)

    def stop(self) -> None:
        """Send the command STOP and return before the axes are at rest.

        If the present connection is lost or does not answer, the command is sent over a new one. The method does not
        wait for standstill because it may be called from inside a sleep of the clock.
        """
        self._braking = True
        session = self._session
        if session.link.connected:
            try:
                session.send_urgent(CommandCode.STOP)
            except LINK_FAILURES:
                session.close()
            else:
                return
        session.open()
        session.send_urgent(CommandCode.STOP)

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
        expected_s = self._expected_s(code, status.position, target, feed_mm_per_s, predicted_s)
        end_s = clock.now() + expected_s + END_MARGIN_S
        deadline = MotionDeadline(
            clock,
            target,
            status.position,
            allowed_s=DURATION_FACTOR * predicted_s + settings.motion_margin_s,
            stall_s=settings.motion_margin_s,
        )
        held_deadline: Deadline | None = None
        fine_s = settings.fine_poll_interval_s
        while _is_under_way(status):
            deadline.observe(status.position)
            if status.state is MotionState.HELD:
                held_deadline = held_deadline or Deadline.after(clock, settings.max_hold_s)
                self._require_resumed(held_deadline)
                # the time of a hold at the machine does not count
                deadline.restart()
                pause_s = slice_s
            else:
                held_deadline = None
                deadline.raise_if_expired(code.label, session.where)
                # Equal parts end exactly at the predicted end: no short last slice, and no poll just before it.
                pause_s = _equal_slice_s(end_s - clock.now(), slice_s)
                if pause_s < fine_s:
                    # Late motions are polled finely at first, then more and more rarely, so that a stalled one does not
                    # load the link.
                    pause_s, fine_s = fine_s, min(1.5 * fine_s, COARSEST_FINE_POLL_S, slice_s)
            clock.sleep(pause_s)
            status = session.poll()
        return status

    def _slice_s(self, interval_s: float) -> float:
        """Return the pause in s between polls: the interval minus a poll's transmission time, with a lower bound."""
        # on a slow serial line the exchange itself takes a good part of the interval
        return max(interval_s - self._session.poll_wire_time_s, self._session.settings.fine_poll_interval_s)

    def _predicted_s(self, start: Triple, target: Triple, feed_mm_per_s: float | None) -> float:
        return move_duration_s(
            start,
            target,
            feed_mm_per_s=feed_mm_per_s,
            rapid_mm_per_s=self._limits.rapid_mm_per_s,
            acceleration_mm_per_s2=self._limits.acceleration_mm_per_s2,
        )

    def _expected_s(
        self, code: CommandCode, start: Triple, target: Triple, feed_mm_per_s: float | None, predicted_s: float
    ) -> float:
        """Return the time in s after which the motion is expected to end: for a touch, the time in which the probe
        trips after the same distance as in the last touch of this length. Balls are found where they are expected to
        hundredths of a millimetre, so that the first poll then mostly shows the end."""
        trip_mm = self._trips_mm.get(_rounded_length(start, target))
        if code is not CommandCode.TOUCH or trip_mm is None:
            return predicted_s
        expected_s = touch_duration_s(
            start,
            target,
            trip_mm,
            feed_mm_per_s=feed_mm_per_s,
            rapid_mm_per_s=self._limits.rapid_mm_per_s,
            acceleration_mm_per_s2=self._limits.acceleration_mm_per_s2,
        )
        return min(expected_s, predicted_s)

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

    def _require_reached(self, code: CommandCode, target: Triple, status: StatusImage) -> None:
        """Raise MotionFault if the position reported with the outcome is not the target; a trip has no target."""
        if status.outcome is MotionOutcome.TRIPPED:
            return
        require_reached(
            status.position, target, self._session.settings.position_tolerance_mm, code.label, self._session.where
        )

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


def _rounded_length(start: Triple, target: Triple) -> float:
    """Return the length of a path in mm, rounded to 0.1 mm: touches with the same search distances have the same."""
    return round(math.dist(start, target), 1)


def _equal_slice_s(remaining_s: float, slice_s: float) -> float:
    """Return the length in s of equal parts of the remaining time, each at most `slice_s`."""
    return remaining_s / math.ceil(remaining_s / slice_s) if remaining_s > 0.0 else 0.0
