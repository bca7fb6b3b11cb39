"""Registers for motion: commands, outcome, latch, fault codes, and supervision of the agent's heartbeat.

Source: docs/reference/modbus-register-map.md, sections 3, 5, 7 and 9.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import isfinite
from typing import Final

import numpy as np

from drivers.roles import MotionState, Permission
from simulators.wire.modbus.physics import MovingMachine
from simulators.wire.modbus.register_map import (
    FaultCode,
    LatchResult,
    ModbusCommandCode,
    ModbusOutcome,
    ModbusState,
    ResultCode,
)

HEARTBEAT_WITHIN_S: Final = 1.0
TRAVEL_TOLERANCE_MM: Final = 1e-9
PERMISSION_BITS: Final = (
    Permission.AUTOMATIC,
    Permission.DOORS_CLOSED,
    Permission.SPINDLE_STOPPED,
    Permission.PROGRAM_IDLE,
    Permission.REFERENCED,
    Permission.NO_FAULT,
    Permission.CONSENT,
)
STATE_OF: Final = {
    MotionState.IDLE: ModbusState.IDLE,
    MotionState.MOVING: ModbusState.MOVING,
    MotionState.HELD: ModbusState.HELD,
    MotionState.FAULT: ModbusState.FAULT,
}
WATCHED_FAULTS: Final = {
    FaultCode.HEARTBEAT_LOST: "agent heartbeat lost",
    FaultCode.DOOR_OPENED: "door opened while moving",
    FaultCode.PERMISSION_LOST: "permission lost while moving",
    FaultCode.PROBE_LOST: "probe lost while moving",
}
"""Faults that the register side detects, not the simulated machine, and the texts with which it reports them to the
machine."""
_FAULT_WORDS: Final = (
    ("collision", FaultCode.COLLISION),
    ("overload", FaultCode.COLLISION),
    ("probe tripped", FaultCode.PROBE_TRIPPED),
    ("emergency", FaultCode.EMERGENCY_STOP),
    ("travel", FaultCode.END_OF_TRAVEL),
    ("following", FaultCode.FOLLOWING_ERROR),
    ("drive", FaultCode.DRIVE),
    *((words, code) for code, words in WATCHED_FAULTS.items()),
)


@dataclass(frozen=True)
class MotionRequest:
    """Motion command with the values that it takes from the command registers."""

    code: ModbusCommandCode
    target_mm: tuple[float, ...]
    feed_mm_per_s: float
    tag: int = 0

    @property
    def rapid(self) -> bool:
        return self.code in (ModbusCommandCode.MOVE_RAPID, ModbusCommandCode.GUARDED_RAPID)

    @property
    def touch(self) -> bool:
        return self.code is ModbusCommandCode.TOUCH

    @property
    def probing(self) -> bool:
        return self.code in (ModbusCommandCode.GUARDED_RAPID, ModbusCommandCode.GUARDED_FEED, ModbusCommandCode.TOUCH)


class MotionRegisters:
    """Registers 1004 … 1037 of the Modbus register map (machine state, motion outcome, latched position), and the data
    from which they are derived.

    After a stop or a fault, the axes first brake. Until they are at rest, the state register shows 1 (moving), and the
    outcome register shows 1 (under way).
    """

    def __init__(self, machine: MovingMachine, now: Callable[[], float]) -> None:
        self._machine = machine
        self._now = now
        self._limits = machine.limits()
        self._request: MotionRequest | None = None
        self._latch_before = 0
        self._watched_since_s = 0.0
        self._ending = False
        self.sequence = 0
        self.outcome = ModbusOutcome.NONE
        self.latch_sequence = 0
        self.latch_result = LatchResult.NONE
        self.latched_mm: tuple[float, float, float] = (0.0, 0.0, 0.0)

    @property
    def state(self) -> ModbusState:
        return STATE_OF[self._machine.motion]

    @property
    def fault(self) -> FaultCode:
        faulty = self._machine.motion is MotionState.FAULT
        return fault_code(self._machine.fault) if faulty else FaultCode.NONE

    @property
    def permissions(self) -> int:
        """Contents of register 1006 of the Modbus register map, in which each permission has one bit."""
        given = self._machine.permissions
        return sum(1 << bit for bit, name in enumerate(PERMISSION_BITS) if given[name])

    @property
    def probe(self) -> int:
        """Contents of register 1007 of the Modbus register map. Bit 0 means that the probe is loaded, bit 1 that it is
        healthy, bit 2 that it is deflected.
        """
        machine = self._machine
        return machine.probe_loaded | machine.probe_healthy << 1 | machine.probe_deflected << 2

    def position_mm(self) -> tuple[float, float, float]:
        x, y, z = self._machine.displayed_position()
        return float(x), float(y), float(z)

    def heartbeat_changed(self) -> None:
        self._watched_since_s = self._now()

    def wakes_at(self) -> float | None:
        """Return the instant in s at which the agent's heartbeat (register 2000) becomes overdue, or None if no axis
        moves.
        """
        if self._ending or self._machine.motion is not MotionState.MOVING:
            return None
        return self._watched_since_s + HEARTBEAT_WITHIN_S

    def observe(self) -> None:
        """Check a motion that is under way.

        The motion is stopped if a permission, the probe or the agent's heartbeat is lost. Once the axes are at rest,
        the outcome of the motion is set.
        """
        if self.outcome is not ModbusOutcome.UNDER_WAY:
            return
        motion = self._machine.motion
        if motion is MotionState.MOVING and not self._ending:
            self._watch()
        if self._machine.motion in (MotionState.IDLE, MotionState.FAULT):
            self._settle()

    def _watch(self) -> None:
        lost = self._lost_while_moving()
        if lost is not FaultCode.NONE:
            self._ending = True
            self._machine.fail(WATCHED_FAULTS[lost])

    def _lost_while_moving(self) -> FaultCode:
        given = self._machine.permissions
        if not given[Permission.DOORS_CLOSED]:
            return FaultCode.DOOR_OPENED
        if not all(given.values()):
            return FaultCode.PERMISSION_LOST
        if self._request is not None and self._request.probing and not self._probe_ready():
            return FaultCode.PROBE_LOST
        expires_s = self._watched_since_s + HEARTBEAT_WITHIN_S
        return FaultCode.HEARTBEAT_LOST if self._now() >= expires_s else FaultCode.NONE

    def _settle(self) -> None:
        if self._machine.motion is MotionState.FAULT:
            self.outcome = outcome_of(self.fault)
        elif self._ending:
            self.outcome = ModbusOutcome.STOPPED
        elif self._request is not None and self._request.touch:
            self._settle_touch()
        else:
            self.outcome = ModbusOutcome.IN_POSITION

    def _settle_touch(self) -> None:
        latch = self._machine.latch
        tripped = latch is not None and latch.sequence != self._latch_before
        x, y, z = latch.position if latch is not None and tripped else self._machine.displayed_position()
        self.latch_sequence = self.sequence
        self.latch_result = LatchResult.TRIPPED if tripped else LatchResult.MISSED
        self.latched_mm = (float(x), float(y), float(z))
        self.outcome = ModbusOutcome.TRIPPED if tripped else ModbusOutcome.MISSED

    def start(self, request: MotionRequest, sequence: int) -> ResultCode:
        refusal = self._refusal(request)
        if refusal is not None:
            return refusal
        target = np.array(request.target_mm)
        latch = self._machine.latch
        self._latch_before = latch.sequence if latch is not None else 0
        self._machine.trace(request.tag)
        if request.touch:
            self._machine.begin_touch(target, request.feed_mm_per_s)
        else:
            self._machine.begin_move(target, None if request.rapid else request.feed_mm_per_s, request.probing)
        self._request, self._ending = request, False
        self.sequence, self.outcome = sequence, ModbusOutcome.UNDER_WAY
        self._watched_since_s = self._now()
        return ResultCode.ACCEPTED

    def _refusal(self, request: MotionRequest) -> ResultCode | None:
        if self.state is not ModbusState.IDLE:
            return ResultCode.NOT_IN_THIS_STATE
        if not all(self._machine.permissions.values()):
            return ResultCode.PERMISSION_MISSING
        return self._illegal_number(request) or self._probe_not_ready(request)

    def _illegal_number(self, request: MotionRequest) -> ResultCode | None:
        if not all(map(isfinite, (*request.target_mm, request.feed_mm_per_s))):
            return ResultCode.ILLEGAL_VALUE
        travel = zip(self._limits.lower_mm, request.target_mm, self._limits.upper_mm, strict=True)
        tolerance = TRAVEL_TOLERANCE_MM
        if not all(low - tolerance <= x <= high + tolerance for low, x, high in travel):
            return ResultCode.OUTSIDE_TRAVEL
        if not request.rapid and not 0.0 < request.feed_mm_per_s <= max(self._limits.rapid_mm_per_s):
            return ResultCode.ILLEGAL_FEED
        return None

    def _probe_not_ready(self, request: MotionRequest) -> ResultCode | None:
        if request.probing and not self._probe_ready():
            return ResultCode.NO_PROBE
        return ResultCode.PROBE_DEFLECTED if request.touch and self._machine.probe_deflected else None

    def hold(self) -> ResultCode:
        if self.state is ModbusState.FAULT:
            return ResultCode.NOT_IN_THIS_STATE
        if self.state is ModbusState.MOVING:
            self._machine.hold()
        return ResultCode.ACCEPTED

    def resume(self) -> ResultCode:
        if self.state is ModbusState.FAULT:
            return ResultCode.NOT_IN_THIS_STATE
        if self.state is ModbusState.HELD:
            self._machine.resume()
            self._watched_since_s = self._now()
        return ResultCode.ACCEPTED

    def stop(self) -> ResultCode:
        """Stop any motion. This command is always accepted."""
        if self.state in (ModbusState.MOVING, ModbusState.HELD):
            self._ending = True
            self._machine.halt()
            self.observe()
        return ResultCode.ACCEPTED

    def reset(self) -> ResultCode:
        if self.state in (ModbusState.MOVING, ModbusState.HELD):
            return ResultCode.NOT_IN_THIS_STATE
        if self._cause_present():
            return ResultCode.CAUSE_PRESENT
        self._machine.reset()
        return ResultCode.ACCEPTED

    def _cause_present(self) -> bool:
        if self.fault is FaultCode.DOOR_OPENED:
            return not self._machine.permissions[Permission.DOORS_CLOSED]
        if self.fault is FaultCode.PERMISSION_LOST:
            given = self._machine.permissions
            return not all(given[name] for name in PERMISSION_BITS if name is not Permission.NO_FAULT)
        return self.fault is FaultCode.PROBE_LOST and not self._probe_ready()

    def _probe_ready(self) -> bool:
        return self._machine.probe_loaded and self._machine.probe_healthy


def fault_code(fault: str) -> FaultCode:
    """Return the fault code of the Modbus register map for a fault text of the simulated machine, or 99 (other) if no
    code matches.
    """
    words = fault.lower()
    for marker, code in _FAULT_WORDS:
        if marker in words:
            return code
    return FaultCode.OTHER


def outcome_of(fault: FaultCode) -> ModbusOutcome:
    """Return the outcome of a motion that ended with the fault code `fault`.

    Fault codes and outcomes are those of docs/reference/modbus-register-map.md, tables 9.1 and 9.3.
    """
    if fault is FaultCode.PROBE_TRIPPED:
        return ModbusOutcome.GUARD_TRIPPED
    return ModbusOutcome.HEARTBEAT_LOST if fault is FaultCode.HEARTBEAT_LOST else ModbusOutcome.FAULT
