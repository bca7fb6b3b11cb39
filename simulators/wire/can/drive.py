"""CiA 402 drive for one axis of the simulated mount, written from the text of this device profile.

The drive implements the power drive state machine, profile position mode, homing mode, quick stop, fault reaction and
limits. The position unit is the encoder count unless the factor group (the objects for resolution, gear ratio and feed)
defines a different unit. Speeds are in position units per second. The drive has no motion of its own: the physics of
the mount advances with the world's clock. The drive reads the state of the mount on every request and after every
advance.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from typing import Protocol

from drivers.errors import DeviceError
from simulators.wire.can.node import CanopenNode
from simulators.wire.can.parameters import HOMING_METHOD, HOMING_SPEED, QUICK_STOP_OPTION, FactorGroup, Parameters
from simulators.wire.can.sdo import ABORT_LOCAL_STATE, ABORT_VALUE, ObjectDictionary, ObjectEntry, SdoAbortError

DEVICE_TYPE_SERVO = 0x0002_0192
"""Device type: additional information 2 (servo drive), profile 402."""
VENDOR_AND_PRODUCT = (0x000003E7, 0x00000402)
PROFILE_POSITION, HOMING = 1, 6
HOMING_HERE = (35, 37)
"""Homing methods that define the present position as home."""

FOLLOWING_ERROR = 0x8611
REFERENCE_LIMIT = 0x8612

NEGATIVE_SWITCH, POSITIVE_SWITCH, HOME_SWITCH = 1, 2, 4
"""Bits of 0x60FD (digital inputs)."""
DC_LINK_MV = 48_000

POSITION_WINDOW_DEG = 0.01
"""Position window (0x6067): distance from the target within which a drive reports it as reached."""


class MountAxes(Protocol):
    """Interface of the mount's physics that a drive needs. Angles are in degrees, and speeds are in degrees/s."""

    def begin_turn(self, axis: str, angle_deg: float, speed_deg_per_s: float | None) -> None: ...

    def position_deg(self, axis: str) -> float: ...

    def moving(self, axis: str) -> bool: ...

    def halt(self, axis: str | None = None) -> None:
        """Brake one axis of the mount, or both if `axis` is None."""


@dataclass(frozen=True)
class DriveConfig:
    """Configuration of one simulated drive.

    `counts_per_degree` is the number of encoder increments per degree, and `zero_deg` is the mount angle at which the
    encoder reads 0. `factors` is the factor group (the objects that define the position unit), or None if the drive has
    none.
    """

    node_id: int
    axis: str
    counts_per_degree: float
    zero_deg: float = 0.0
    device_name: str = "volcal simulated servo drive"
    identity: tuple[int, int, int, int] = (*VENDOR_AND_PRODUCT, 1, 1)
    factors: FactorGroup | None = None


class PowerDriveState(IntEnum):
    """States of a CiA 402 drive.

    The values are bits 0-3, 5 and 6 of the statusword (bit 5, quick stop, is active low).
    """

    NOT_READY = 0x00
    SWITCH_ON_DISABLED = 0x40
    READY = 0x21
    SWITCHED_ON = 0x23
    ENABLED = 0x27
    QUICK_STOP = 0x07
    FAULT_REACTION = 0x0F
    FAULT = 0x08


POWERED = frozenset({PowerDriveState.SWITCHED_ON, PowerDriveState.ENABLED, PowerDriveState.QUICK_STOP})


class ServoDrive:
    """Device application of one simulated drive (the part without communication), which a `CanopenNode` connects to the
    bus.
    """

    def __init__(self, config: DriveConfig, axes: MountAxes) -> None:
        self._config = config
        self._axes = axes
        self._zero_deg = config.zero_deg
        self.parameters = Parameters(config.factors)
        self._emergencies: list[int] = []
        self._jammed = False
        self._deviating = False
        self._switches = 0
        self._home_switch = True
        self.reset()

    def reset(self) -> None:
        self._state = PowerDriveState.SWITCH_ON_DISABLED
        self._controlword = 0
        self._mode = 0
        self._error_code = 0
        self._persistent = False
        self._target = 0
        self._velocity = 0
        self.parameters.reset()
        self._homing_error = False
        self._acknowledged = False
        self._buffered: int | None = None
        self._goal: int | None = None  # of the current motion; reached means at the goal, not merely at rest
        self._underway = False
        self._clipped = False
        self._homing_attained = False
        self._halted = False
        self._axes.halt(self._config.axis)

    @property
    def state(self) -> PowerDriveState:
        self._settle()
        return self._state

    @property
    def error_register(self) -> int:
        """Value of the error register, object 0x1001. Bit 0 means a generic error, and bit 5 means an error specific to
        the device profile.
        """
        return 0x21 if self._state in (PowerDriveState.FAULT, PowerDriveState.FAULT_REACTION) else 0x00

    def trip(self, code: int, *, persistent: bool = False) -> None:
        """Cause an internal fault: stop the motion and send an emergency message with the error code `code`.

        A reset does not clear a `persistent` fault.
        """
        self._error_code = code
        self._persistent = persistent
        self._emergencies.append(code)
        self._state = PowerDriveState.FAULT_REACTION
        self._stop_motion()

    def jam(self, *, jammed: bool = True) -> None:
        """Block the axis. A moving axis stops, and the drive then accepts commands without moving the axis."""
        self._jammed = jammed
        if jammed and self._underway:
            self._axes.halt(self._config.axis)

    def deviate(self, *, deviating: bool = True) -> None:
        """Set statusword bit 13 (following error or homing error) without causing a fault."""
        self._deviating = deviating

    def press_limit_switch(self, direction: int, *, pressed: bool = True) -> None:
        """Press the limit switch in the given `direction` of the encoder counts (1 or -1).

        A motion in this direction stops.
        """
        bit = POSITIVE_SWITCH if direction > 0 else NEGATIVE_SWITCH
        self._switches = self._switches | bit if pressed else self._switches & ~bit
        self._stop_at_switch()

    def lose_home_switch(self, *, lost: bool = True) -> None:
        """Simulate a broken reference switch or cable. A homing method that needs the switch then fails."""
        self._home_switch = not lost

    def warn(self, code: int) -> None:
        """Send an emergency message with the error code `code`, without entering a fault state."""
        self._emergencies.append(code)

    def take_emergencies(self) -> list[int]:
        codes, self._emergencies = self._emergencies, []
        return codes

    def advance(self, now_s: float) -> None:
        del now_s
        self._settle()

    def dictionary(self) -> ObjectDictionary:
        entries = {
            (0x603F, 0): ObjectEntry("H", lambda: self._error_code),
            (0x6040, 0): ObjectEntry("H", lambda: self._controlword, self._control),
            (0x6041, 0): ObjectEntry("H", self._statusword),
            (0x6060, 0): ObjectEntry("b", lambda: self._mode, self._set_mode),
            (0x6061, 0): ObjectEntry("b", lambda: self._mode),
            (0x6064, 0): ObjectEntry("i", self._position),
            (0x607A, 0): ObjectEntry("i", lambda: self._target, self._set_target),
            (0x6081, 0): ObjectEntry("I", lambda: self._velocity, self._set_velocity),
            (0x6079, 0): ObjectEntry("I", lambda: DC_LINK_MV),
            (0x60F4, 0): ObjectEntry("i", self._following_distance),
            (0x60FD, 0): ObjectEntry("I", lambda: self._switches | (HOME_SWITCH if self._at_home() else 0)),
            (0x6502, 0): ObjectEntry("I", lambda: 1 << PROFILE_POSITION - 1 | 1 << HOMING - 1),
        }
        return {**entries, **self.parameters.dictionary()}

    def _set_target(self, value: int) -> None:
        self._target = value

    def _set_velocity(self, value: int) -> None:
        self._velocity = value

    def _set_mode(self, mode: int) -> None:
        if mode not in (PROFILE_POSITION, HOMING):
            raise SdoAbortError(ABORT_VALUE)
        if self._underway:
            raise SdoAbortError(ABORT_LOCAL_STATE)
        self._mode = mode
        self._acknowledged = False

    @property
    def _units_per_degree(self) -> float:
        return self._config.counts_per_degree * self.parameters.units_per_increment

    def _position(self) -> int:
        return round((self._axes.position_deg(self._config.axis) - self._zero_deg) * self._units_per_degree)

    def _following_distance(self) -> int:
        return self._goal - self._position() if self._jammed and self._underway and self._goal is not None else 0

    def _at_home(self) -> bool:
        away_deg = self._axes.position_deg(self._config.axis) - self._config.zero_deg
        return self._home_switch and abs(away_deg) <= POSITION_WINDOW_DEG

    def _statusword(self) -> int:
        self._settle()
        word = self._state | 0x0200
        if self._state in POWERED:
            word |= 0x0010
        if not self._underway:
            word |= 0x0400
        if self._homing_attained if self._mode == HOMING else self._acknowledged:
            word |= 0x1000
        if self._state is PowerDriveState.ENABLED and (
            self._deviating or (self._homing_error and self._mode == HOMING)
        ):
            word |= 0x2000
        if self._switches or self._clipped:
            word |= 0x0800
        return word

    def _control(self, word: int) -> None:
        self._settle()
        rising = word & ~self._controlword
        self._controlword = word
        if self._state in (PowerDriveState.FAULT, PowerDriveState.FAULT_REACTION):
            if rising & 0x80 and self._state is PowerDriveState.FAULT and not self._persistent:
                self._error_code = 0
                self._emergencies.append(0)
                self._state = PowerDriveState.SWITCH_ON_DISABLED
            return
        self._command(word)
        if self._state is PowerDriveState.ENABLED:
            self._operate(word, rising)

    def _command(self, word: int) -> None:
        """Execute the device control commands of the profile, by controlword bits 0-3."""
        state = self._state
        if not word & 0x02:
            self._power_off(PowerDriveState.SWITCH_ON_DISABLED)
        elif not word & 0x04:
            self._quick_stop()
        elif not word & 0x01:
            if state in (PowerDriveState.SWITCH_ON_DISABLED, PowerDriveState.SWITCHED_ON, PowerDriveState.ENABLED):
                self._power_off(PowerDriveState.READY)
        elif state is PowerDriveState.READY or (state is PowerDriveState.ENABLED and not word & 0x08):
            self._power_off(PowerDriveState.SWITCHED_ON)
        elif state is PowerDriveState.SWITCHED_ON and word & 0x08:
            self._state = PowerDriveState.ENABLED

    def _power_off(self, state: PowerDriveState) -> None:
        if self._state in (PowerDriveState.ENABLED, PowerDriveState.QUICK_STOP):
            self._stop_motion()
        self._state = state

    def _quick_stop(self) -> None:
        if self._state is PowerDriveState.ENABLED:
            self._state = PowerDriveState.QUICK_STOP
            self._stop_motion()
        elif self._state in (PowerDriveState.READY, PowerDriveState.SWITCHED_ON):
            self._state = PowerDriveState.SWITCH_ON_DISABLED

    def _operate(self, word: int, rising: int) -> None:
        """Handle the mode-specific bits 4, 5 and 6 of the controlword, and bit 8 (halt)."""
        if rising & 0x100:
            self._halted = True
            self._stop_motion()
        elif not word & 0x100:
            self._halted = False
        if self._mode == HOMING:
            if rising & 0x10:
                self._begin_homing()
            return
        if self._mode != PROFILE_POSITION:
            return
        if rising & 0x10 and not self._acknowledged:
            self._accept(word)
        elif not word & 0x10:
            self._acknowledged = False

    def _accept(self, word: int) -> None:
        """Accept a set-point, to be executed at once (bit 5) or after the current one; only one set-point is
        buffered.
        """
        target = self._target + (self._position() if word & 0x40 else 0)
        if self._underway and not word & 0x20:
            if self._buffered is not None:
                return
            self._buffered = target
        else:
            self._buffered = None
            self._begin(target, self._velocity)
        self._acknowledged = True

    def _begin_homing(self) -> None:
        self._homing_attained = False
        self._homing_error = False
        if self.parameters[HOMING_METHOD] in HOMING_HERE:
            self._zero_deg = self._axes.position_deg(self._config.axis)
            self._homing_attained = True
        else:
            self._zero_deg = self._config.zero_deg
            self._begin(0, self.parameters[HOMING_SPEED])

    def _begin(self, target: int, speed: int) -> None:
        """Start a motion. A target beyond a software limit is replaced by the limit, and bit 11 is set."""
        self._underway = True
        self._goal = target
        allowed = target if self._mode == HOMING else self.parameters.within_limits(target)
        self._clipped = allowed != target
        if self._jammed or self._halted or self._barred():
            return
        angle_deg = self._zero_deg + allowed / self._units_per_degree
        speed_deg_per_s = speed / abs(self._units_per_degree) or None
        try:
            self._axes.begin_turn(self._config.axis, angle_deg, speed_deg_per_s)
        except (DeviceError, ValueError):  # refused by the mechanical stops
            self.trip(REFERENCE_LIMIT)

    def _barred(self) -> bool:
        """Return True if an active limit switch blocks motion towards the goal."""
        ahead = (self._goal or 0) - self._position()
        return bool(self._switches & (POSITIVE_SWITCH if ahead > 0 else NEGATIVE_SWITCH))

    def _stop_at_switch(self) -> None:
        """Stop at an active limit switch, without changing the goal, which is then not reached."""
        if self._underway and self._barred():
            self._axes.halt(self._config.axis)

    def _at_goal(self) -> bool:
        window = max(1.0, POSITION_WINDOW_DEG * abs(self._units_per_degree))
        return self._goal is not None and abs(self._position() - self._goal) <= window

    def _stop_motion(self) -> None:
        self._underway = False
        self._buffered = None
        self._axes.halt(self._config.axis)

    def _settle(self) -> None:
        """Execute the state transitions that are due."""
        moving = self._axes.moving(self._config.axis)
        if self._state is PowerDriveState.FAULT_REACTION and not moving:
            self._state = PowerDriveState.FAULT
        if self._state is PowerDriveState.QUICK_STOP and not moving and self.parameters[QUICK_STOP_OPTION] in range(5):
            self._state = PowerDriveState.SWITCH_ON_DISABLED
        if self._underway and not moving and self._at_goal():
            self._underway = False
            if self._mode == HOMING:
                self._homing_attained = self._at_home()
                self._homing_error = not self._homing_attained
            if self._buffered is not None:
                target, self._buffered = self._buffered, None
                self._begin(target, self._velocity)


def drive_node(config: DriveConfig, axes: MountAxes) -> tuple[CanopenNode, ServoDrive]:
    """Create a drive, and return its CANopen node and the drive itself."""
    drive = ServoDrive(config, axes)
    node = CanopenNode(
        config.node_id,
        drive,
        device_type=DEVICE_TYPE_SERVO,
        device_name=config.device_name,
        identity=config.identity,
    )
    return node, drive
