"""One axis of the rotary mount: a CiA 402 drive in profile position mode and homing mode.

The driver polls the statusword of the drive with SDO requests (service data objects). It waits on a clock that it is
given, so its behaviour is the same in virtual and in real time. It does not use PDOs (process data objects), because
the positions in PDOs lag by a cycle.
"""

from __future__ import annotations

from collections.abc import Callable, Collection

import structlog

from drivers.canopen_mount import objects, states
from drivers.canopen_mount.emergency import emergency_text
from drivers.canopen_mount.factors import verify_factors
from drivers.canopen_mount.identity import verify_identity
from drivers.canopen_mount.limits import SoftLimits, blocking_limit, describe_unreached_target, read_soft_limits
from drivers.canopen_mount.node import DriveNode, NodeMonitor
from drivers.canopen_mount.scale import turn_duration_s
from drivers.canopen_mount.settings import AxisSettings, HomingSettings
from drivers.canopen_mount.states import ENABLE_TRANSITIONS, DriveState, StateTransition, drive_state
from drivers.clock import Clock, Deadline, without_interrupts
from drivers.errors import CommandRejected, DeadlineExpired, MotionFault, ProtocolError

POLL_S = 0.02
"""Pause in s between two polls of an awaited state."""
HANDSHAKE_S = 1.0
"""Time limit in s for the set-point acknowledge and the mode display."""
MAX_TRANSITIONS = 8
"""Largest number of transitions to *operation enabled*.

At most seven are needed, so a drive that is not enabled after eight transitions is repeating states.
"""

_log = structlog.get_logger("canopen_mount")


class Drive:
    """Drive of one axis of the rotary mount; all angles are angles of the mount in degrees.

    Every wait has a time limit. If an exception occurs, this class does not stop its drive. Its caller, the mount,
    stops the drives of both axes instead.
    """

    def __init__(
        self,
        node: DriveNode,
        settings: AxisSettings,
        clock: Clock,
        *,
        heartbeat_ms: int,
        heartbeat_timeout_s: float,
        tolerated_emergencies: Collection[int] = (),
    ) -> None:
        self.node = node
        self.settings = settings
        self._heartbeat_ms = heartbeat_ms
        self._monitor = NodeMonitor(node, clock, timeout_s=heartbeat_timeout_s if heartbeat_ms else None)
        self._clock = clock
        self._scale = settings.scale
        self._tolerated = tolerated_emergencies
        self._mode: int | None = None
        self._target = 0
        self._direction = 0
        self._state_as_found = True
        self._enabled_here = False
        self._soft_limits: SoftLimits | None = None
        self._limit_logged = False
        self._homed = settings.homing is None
        self._prepared = False

    def verify(self) -> None:
        """Verify that the drive's identity and units match the settings, and read its software limits for later checks.

        Raises ProtocolError if the identity differs, and ConfigurationError if the units differ. If the setting
        `units.write` is true, differing units are first written to the drive; otherwise nothing is written.
        """
        verify_identity(self.node, self.settings)
        verify_factors(self.node, self.settings)
        self._soft_limits = read_soft_limits(self.node)

    def look(self) -> None:
        """Verify by reading that the drive of the settings answers. Raises ProtocolError if its identity differs."""
        verify_identity(self.node, self.settings)
        self.state()
        self.angle_deg()

    @property
    def identity_stated(self) -> bool:
        return self.settings.vendor_id is not None and self.settings.product_code is not None

    def angle_deg(self) -> float:
        return self._scale.angle_deg(self.node.read(objects.POSITION))

    def state(self) -> DriveState:
        return self.state_of(self.node.read(objects.STATUSWORD))

    def require_within_limits(self, angle_deg: float) -> None:
        """Raise CommandRejected if the target angle is outside the limits of the settings or the software limits of the
        drive.

        Nothing is sent to the drive.
        """
        lower, upper = self.settings.lower_deg, self.settings.upper_deg
        if not lower <= angle_deg <= upper:
            raise CommandRejected(
                f"{self.node.axis} {angle_deg:g} degrees is outside the limits {lower:g} ... {upper:g}",
                hint="choose a position set within the limits of the mount, or correct them in its settings",
                **self.node.where,
            )
        soft_limits = self._soft_limits
        if soft_limits is not None and not soft_limits.contains(self._scale.counts(angle_deg)):
            lower, upper = sorted((self._scale.angle_deg(soft_limits.lower), self._scale.angle_deg(soft_limits.upper)))
            raise CommandRejected(
                f"{self.node.axis} {angle_deg:g} degrees is outside the drive's own software limits"
                f" {lower:g} ... {upper:g} (0x607D)",
                hint="choose a position within them, or set 0x607D of the drive as wide as the mount allows",
                **self.node.where,
            )

    def require_homed(self) -> None:
        if not self._homed:
            raise CommandRejected(
                f"{self.node.axis} has not been homed since it was switched on or opened",
                hint="home the mount first",
                **self.node.where,
            )

    def prepare(self) -> None:
        """Set the heartbeat time of the drive's CAN node and switch the node to the state *operational*.

        The drive does not move. The state is switched by a command of the network management (NMT). A call is necessary
        when the connection to the mount is opened, and again after a restart of the node.
        """
        self.node.write(objects.HEARTBEAT_TIME, self._heartbeat_ms)
        self.node.start()
        self._mode = None
        self._prepared = True
        self._state_as_found = True
        self._monitor.arm()

    def enable(self) -> None:
        """Bring the drive to the state *operation enabled* by the transitions of the CiA 402 state machine.

        The transitions are listed in `ENABLE_TRANSITIONS`. If the drive is already enabled at the first query of its
        state, it is stopped before it is enabled again. A fault that is found during the transitions is reset.
        """
        if not self._prepared:
            self.prepare()
        self._enabled_here = True
        for _ in range(MAX_TRANSITIONS):
            state = self.state()
            self.check()  # every message sent before that answer has been received now
            if state is DriveState.OPERATION_ENABLED:
                if not self._state_as_found:
                    return
                self.quick_stop()  # a previous user may have left it turning
            elif state is DriveState.FAULT:
                self._reset_fault()
            else:
                self._perform(ENABLE_TRANSITIONS[state])
            self._state_as_found = False
        raise MotionFault(
            "the drive does not reach operation enabled", hint="check its enable inputs", **self.node.where
        )

    def _reset_fault(self) -> None:
        _log.warning("fault reset", text=self.fault_text(), **self.node.where)
        try:
            self._perform(ENABLE_TRANSITIONS[DriveState.FAULT])
        except DeadlineExpired as error:
            raise self._fault("the fault of the drive cannot be reset") from error

    def start_turn(self, angle_deg: float) -> float:
        """Start a turn to the given angle and return its predicted duration in s.

        The caller must have checked before that the angle is within the limits.
        """
        self._enter_profile_position()
        self._limit_logged = False
        self._target = self._scale.counts(angle_deg)
        start = self.node.read(objects.POSITION)
        self._direction = (self._target > start) - (self._target < start)
        self.node.write(objects.TARGET_POSITION, self._target)
        self._give_set_point()
        return turn_duration_s(
            angle_deg - self._scale.angle_deg(start),
            self.settings.speed_deg_per_s,
            self.settings.acceleration_deg_per_s2,
        )

    def _give_set_point(self) -> None:
        self.node.write(objects.CONTROLWORD, states.NEW_SET_POINT)
        self._await_handshake(
            "the set-point to be acknowledged (statusword bit 12)",
            lambda: bool(self._statusword_in_motion() & states.SET_POINT_ACKNOWLEDGE),
        )
        self.node.write(objects.CONTROLWORD, states.ENABLE_OPERATION)

    def hold_turn(self) -> None:
        """Brake the turn in progress. Does nothing if the drive is not enabled, since the command would enable it."""
        if self.state() is DriveState.OPERATION_ENABLED:
            self.node.write(objects.CONTROLWORD, states.HALT)

    def resume_turn(self) -> None:
        """Continue a held turn to its target. The set-point is given again, because drives differ in whether they
        continue by themselves. Raises the same errors as `turn_ended`."""
        self._statusword_in_motion()
        self.node.write(objects.CONTROLWORD, states.ENABLE_OPERATION)
        self._give_set_point()

    def turn_ended(self) -> bool:
        """Poll the drive once and return True if the target of the turn is reached.

        Raises MotionFault if the drive reports a fault or a following error, or has left the state *operation enabled*.
        """
        return bool(self._statusword_in_motion() & states.TARGET_REACHED)

    def describe_unreached_target(self) -> str:
        """Return a text that explains why a turn has not reached its target.

        The text gives the position, the limit that blocks the turn (if there is one), and the following error.
        """
        return describe_unreached_target(self.node, self._scale, self._target, self._direction)

    def start_homing(self, homing: HomingSettings) -> None:
        self._homed = False
        self._enter_mode(objects.HOMING)
        self.node.write(objects.HOMING_METHOD, homing.method)
        self.node.write(objects.HOMING_SEARCH_SPEED, self._scale.rate(homing.search_speed_deg_per_s))
        self.node.write(objects.HOMING_LATCH_SPEED, self._scale.rate(homing.latch_speed_deg_per_s))
        self.node.write(objects.HOMING_ACCELERATION, self._scale.rate(homing.acceleration_deg_per_s2))
        self.node.write(objects.CONTROLWORD, states.START_HOMING)

    def homing_ended(self) -> bool:
        """Poll the drive once and return True if homing is attained and the axis is at rest (bits 12 and 10).

        The bits are those of the statusword. Raises MotionFault if the drive reports a homing error.
        """
        status = self._statusword_in_motion()
        done = bool(status & states.SET_POINT_ACKNOWLEDGE and status & states.TARGET_REACHED)
        if done:
            self.node.write(objects.CONTROLWORD, states.ENABLE_OPERATION)
            self._homed = True
        return done

    def quick_stop(self) -> None:
        """Command a quick stop of the drive.

        The method never sleeps, since it must also work after a wait on the clock has been aborted. Raises MotionFault
        if the drive ignores the command.
        """
        for _ in range(2):
            self.node.write(objects.CONTROLWORD, states.QUICK_STOP)
            if drive_state(self.node.read(objects.STATUSWORD)) is not DriveState.OPERATION_ENABLED:
                return
        raise MotionFault("the drive ignores the quick stop", hint="use the emergency stop", **self.node.where)

    def release(self) -> None:
        """Switch off the power of the drive's motor; the brake or the gear of the axis holds the mount.

        The method has no effect if this object has not enabled the drive, because a diagnosis must not stop a motion of
        another process.
        """
        if self._enabled_here:
            self._enabled_here = False
            self.node.write(objects.CONTROLWORD, states.DISABLE_VOLTAGE)

    def fault_text(self) -> str:
        """Return the text of the error code that the drive reports in object 0x603F."""
        return emergency_text(self.node.read(objects.ERROR_CODE))

    def check(self) -> list[int]:
        """Return the error codes of the drive's emergency messages that were received since the last call.

        Raises MotionFault if the drive's CAN node has restarted or left the network state (NMT state) *operational*.
        Raises LinkTimeout or LinkLost if the node no longer answers.
        """
        try:
            return self._monitor.check()
        except MotionFault:
            self._prepared = False
            self._homed = self.settings.homing is None
            raise

    def impairment(self) -> str:
        """Return what is impaired in the monitoring of the drive, or an empty text."""
        if not self._monitor.silent:
            return ""
        name = f"the drive of the {self.node.axis} (node {self.node.node_id})"
        return (
            f"{name} sends no heartbeat, but still answers: check its heartbeat time (0x1017) and the load of the bus"
        )

    def check_in_motion(self) -> None:
        """Call `check`; raise MotionFault if it returns an emergency error code that the settings do not tolerate."""
        self._require_no_emergency(self.check())

    def _require_no_emergency(self, codes: list[int]) -> None:
        serious = [code for code in codes if code not in self._tolerated]
        if serious:
            raise MotionFault(
                f"emergency message of the drive: {', '.join(emergency_text(code) for code in serious)}",
                hint="remove the cause; if the code is only a warning, add it to tolerated_emergencies",
                **self.node.where,
            )

    def _statusword_in_motion(self) -> int:
        status = self.node.read(objects.STATUSWORD)
        codes = self.check()
        state = self.state_of(status)
        if state in (DriveState.FAULT, DriveState.FAULT_REACTION):
            raise self._fault("the drive went into fault")
        self._require_no_emergency(codes)
        if state is not DriveState.OPERATION_ENABLED:
            action = "made a quick stop" if state is DriveState.QUICK_STOP_ACTIVE else "left operation enabled"
            raise MotionFault(
                f"the drive {action}, it is in {state.value}",
                hint="check for a stop, an open enable input or another CANopen master",
                **self.node.where,
            )
        homing = self._mode == objects.HOMING
        if status & states.FOLLOWING_ERROR:
            raise self._homing_error() if homing else self._fault("following error (statusword bit 13)")
        if status & states.INTERNAL_LIMIT and not homing:
            self._handle_internal_limit()
        return status

    def _homing_error(self) -> MotionFault:
        homing = self.settings.homing
        method = f", method {homing.method}" if homing is not None else ""
        return MotionFault(
            f"homing failed (statusword bit 13{method}): {self.fault_text()}",
            hint="check the reference and limit switches, their cables, and that the method fits them",
            **self.node.where,
        )

    def _handle_internal_limit(self) -> None:
        """Handle an active internal limit (bit 11): raise MotionFault if a limit blocks the turn, otherwise log it.

        The bit may also mean that the current is limited, which does not end the turn.
        """
        if reason := blocking_limit(self.node, self._target, self._direction):
            raise MotionFault(
                f"stopped at a limit (statusword bit 11): {reason}",
                hint="check the limits of the drive and of the settings, the zero of the encoder, and the switches",
                **self.node.where,
            )
        if not self._limit_logged:
            self._limit_logged = True
            _log.warning("internal limit active", **self.node.where)

    def state_of(self, statusword: int) -> DriveState:
        state = drive_state(statusword)
        if state is None:
            raise ProtocolError(f"statusword 0x{statusword:04X} is not a state of CiA 402", **self.node.where)
        return state

    def _fault(self, what: str) -> MotionFault:
        return MotionFault(
            f"{what}: {self.fault_text()}",
            hint="remove the cause; the fault is reset when the mount is next turned or homed",
            **self.node.where,
        )

    def _perform(self, step: StateTransition) -> None:
        for controlword in step.controlwords:
            self.node.write(objects.CONTROLWORD, controlword)
        self._await(f"the drive to be {step.target.value}", lambda: self._has_reached(step.target), step.within_s)

    def _has_reached(self, awaited: DriveState) -> bool:
        state = self.state()
        if state in (DriveState.FAULT, DriveState.FAULT_REACTION) and awaited not in (
            DriveState.FAULT,
            DriveState.SWITCH_ON_DISABLED,
        ):
            raise self._fault("the drive went into fault while it was enabled")
        return state is awaited

    def _enter_profile_position(self) -> None:
        if self._mode == objects.PROFILE_POSITION:
            return
        self._enter_mode(objects.PROFILE_POSITION)
        self.node.write(objects.PROFILE_VELOCITY, self._scale.rate(self.settings.speed_deg_per_s))
        ramp = self._scale.rate(self.settings.acceleration_deg_per_s2)
        self.node.write(objects.PROFILE_ACCELERATION, ramp)
        self.node.write(objects.PROFILE_DECELERATION, ramp)

    def _enter_mode(self, mode: int) -> None:
        self._mode = None
        self.node.write(objects.MODE, mode)
        self._await_handshake(
            f"mode of operation {mode} (0x6061)", lambda: self.node.read(objects.MODE_DISPLAY) == mode
        )
        self._mode = mode

    def _await_handshake(self, awaited: str, arrived: Callable[[], bool]) -> None:
        """Wait for an answer of the drive. A hold takes effect only after it, when both axes turn and can be held."""
        self._await_on(without_interrupts(self._clock), awaited, arrived, HANDSHAKE_S)

    def _await(self, awaited: str, arrived: Callable[[], bool], within_s: float) -> None:
        self._await_on(self._clock, awaited, arrived, within_s)

    def _await_on(self, clock: Clock, awaited: str, arrived: Callable[[], bool], within_s: float) -> None:
        deadline = Deadline.after(clock, within_s)
        while not arrived():
            deadline.raise_if_expired(
                awaited, hint="check the drive's enable inputs and its display", **self.node.where
            )
            clock.sleep(POLL_S)
