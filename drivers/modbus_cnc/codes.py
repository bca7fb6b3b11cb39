"""Codes from sections 3, 5 and 9 of the register map (docs/reference/modbus-register-map.md)."""

from __future__ import annotations

from enum import IntEnum

from drivers.roles import Activation, MotionState, Permission

# "VC" in ASCII.
PROTOCOL = 0x5643
MAJOR_VERSION = 1


class CommandCode(IntEnum):
    """Codes of the commands that the driver writes to the command block of the Modbus register map."""

    MOVE_RAPID = 11
    MOVE_FEED = 12
    GUARDED_RAPID = 13
    GUARDED_FEED = 14
    TOUCH = 15
    HOLD = 21
    RESUME = 22
    STOP = 23
    RESET = 24
    TABLE_BEGIN = 31
    TABLE_COMMIT = 32
    TABLE_ARM = 33
    TABLE_ACTIVATE = 34

    @property
    def label(self) -> str:
        return self.name.replace("_", " ")


class MotionOutcome(IntEnum):
    """Codes for the outcome of a motion (table 9.3 of docs/reference/modbus-register-map.md)."""

    NONE = 0
    UNDER_WAY = 1
    IN_POSITION = 2
    TRIPPED = 3
    MISSED = 4
    GUARD_TRIPPED = 5
    STOPPED = 6
    HEARTBEAT_LOST = 7
    FAULT = 8


class BankState(IntEnum):
    EMPTY = 0
    BEING_WRITTEN = 1
    COMPLETE = 2
    DAMAGED = 3


STATES = {0: MotionState.IDLE, 1: MotionState.MOVING, 2: MotionState.HELD, 3: MotionState.FAULT}

PERMISSION_BITS = (
    Permission.AUTOMATIC,
    Permission.DOORS_CLOSED,
    Permission.SPINDLE_STOPPED,
    Permission.PROGRAM_IDLE,
    Permission.REFERENCED,
    Permission.NO_FAULT,
    Permission.CONSENT,
)

PROBE_LOADED, PROBE_HEALTHY, PROBE_DEFLECTED = 1, 2, 4

FAULT_GUARD_TRIPPED = 5
FAULT_HEARTBEAT_LOST = 6
FAULTS = {
    1: "emergency stop",
    2: "end of travel",
    3: "following error",
    4: "drive or power fault",
    FAULT_GUARD_TRIPPED: "probe tripped in a move that was not a touch",
    FAULT_HEARTBEAT_LOST: "controller missed the agent's heartbeat",
    7: "door opened while moving",
    8: "a permission was lost while moving",
    9: "probe lost while moving",
    10: "collision or overload detected",
    99: "fault; check the controller's own alarm",
}
PERMISSION_FAULTS = (7, 8)

ACCEPTED = 1
PERMISSION_MISSING = 4
OUTSIDE_TRAVEL = 5
CRC_DIFFERS = 24
RESULTS = {
    2: "unknown command",
    3: "not in this state",
    PERMISSION_MISSING: "a permission is missing",
    OUTSIDE_TRAVEL: "target outside the travel",
    6: "feed not positive or too high",
    7: "illegal value",
    8: "probe not loaded or not healthy",
    9: "cause of the fault still present",
    10: "probe already deflected",
    20: "no such bank",
    21: "bank is active or pending",
    22: "descriptor not allowed",
    23: "blocks missing or out of order",
    CRC_DIFFERS: "CRC-32 differs",
    25: "not armed for this bank and nonce, or too late",
    26: "bank not complete",
    27: "no transfer open for this bank",
}

ACTIVATIONS = {
    0: Activation.IMMEDIATE,
    1: Activation.RESET,
    2: Activation.POWER_CYCLE,
    3: Activation.REFERENCE,
}

NO_BANK = 0xFFFF
NO_BLOCK = 0xFFFF
NO_TEMPERATURE = -(2**31)


def fault_text(code: int) -> str:
    """Return the text of a fault code of the Modbus register map, or an empty string for code 0 (no fault)."""
    return f"{FAULTS.get(code, 'unknown fault')} (code {code})" if code else ""


def result_text(code: int) -> str:
    return f"{RESULTS.get(code, 'unknown reason')} (code {code})"
