"""Table of the state machine of a CiA 402 drive.

Bits 0-3, 5 and 6 of the drive's statusword give the state. `ENABLE_TRANSITIONS` contains, for each state, the next
transition towards *operation enabled*: its controlwords, its target state and its time limit. A transition without a
controlword occurs in the drive without a command.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum


class DriveState(Enum):
    NOT_READY = "not ready to switch on"
    SWITCH_ON_DISABLED = "switch on disabled"
    READY = "ready to switch on"
    SWITCHED_ON = "switched on"
    OPERATION_ENABLED = "operation enabled"
    QUICK_STOP_ACTIVE = "quick stop active"
    FAULT_REACTION = "fault reaction active"
    FAULT = "fault"


# Mask 0x4F: bits 0 to 3 and 6, in states in which bit 5 (quick stop) has no meaning. Mask 0x6F: bit 5 as well.
_PATTERNS = (
    (0x4F, 0x00, DriveState.NOT_READY),
    (0x4F, 0x40, DriveState.SWITCH_ON_DISABLED),
    (0x6F, 0x21, DriveState.READY),
    (0x6F, 0x23, DriveState.SWITCHED_ON),
    (0x6F, 0x27, DriveState.OPERATION_ENABLED),
    (0x6F, 0x07, DriveState.QUICK_STOP_ACTIVE),
    (0x4F, 0x0F, DriveState.FAULT_REACTION),
    (0x4F, 0x08, DriveState.FAULT),
)

WARNING = 1 << 7
TARGET_REACHED = 1 << 10
INTERNAL_LIMIT = 1 << 11
SET_POINT_ACKNOWLEDGE = 1 << 12
"""Statusword bit 12: set-point acknowledge in profile position mode, homing attained in homing mode."""
FOLLOWING_ERROR = 1 << 13
"""Statusword bit 13: following error in profile position mode, homing error in homing mode."""

DISABLE_VOLTAGE = 0x0000
QUICK_STOP = 0x0002
SHUTDOWN = 0x0006
SWITCH_ON = 0x0007
ENABLE_OPERATION = 0x000F
FAULT_RESET = 0x0080
"""Controlword of a fault reset, which takes effect on the rising edge of bit 7.

Therefore a controlword with bit 7 clear is written first.
"""
# Change immediately: a new target takes effect at once, not at the end of the present motion.
NEW_SET_POINT = ENABLE_OPERATION | 0x0030
"""Controlword of a new set-point: bit 4 (new set-point) and bit 5 (change immediately) set, bit 6 clear (absolute)."""
HALT = ENABLE_OPERATION | 0x0100
"""Controlword that brakes the motion in progress (bit 8); the drive stays in *operation enabled*."""
START_HOMING = ENABLE_OPERATION | 0x0010


@dataclass(frozen=True)
class StateTransition:
    """Transition of the state machine of a CiA 402 drive.

    `controlwords` are written to the drive in order. The drive must then reach the state `target` within `within_s` of
    machine time.
    """

    controlwords: tuple[int, ...]
    target: DriveState
    within_s: float


ENABLE_TRANSITIONS: dict[DriveState, StateTransition] = {
    DriveState.NOT_READY: StateTransition((), DriveState.SWITCH_ON_DISABLED, 10.0),
    DriveState.FAULT_REACTION: StateTransition((), DriveState.FAULT, 5.0),
    DriveState.FAULT: StateTransition((DISABLE_VOLTAGE, FAULT_RESET), DriveState.SWITCH_ON_DISABLED, 2.0),
    DriveState.QUICK_STOP_ACTIVE: StateTransition((DISABLE_VOLTAGE,), DriveState.SWITCH_ON_DISABLED, 5.0),
    DriveState.SWITCH_ON_DISABLED: StateTransition((SHUTDOWN,), DriveState.READY, 1.0),
    DriveState.READY: StateTransition((SWITCH_ON,), DriveState.SWITCHED_ON, 3.0),
    DriveState.SWITCHED_ON: StateTransition((ENABLE_OPERATION,), DriveState.OPERATION_ENABLED, 3.0),
}
"""Transitions 1, 14, 15, 12, 2, 3 and 4 of CiA 402, which lead to *operation enabled*, by initial state.

The time limits of several seconds allow for power stages and brakes.
"""


def drive_state(statusword: int) -> DriveState | None:
    """Return the state of a CiA 402 drive given by its statusword; None for a pattern that CiA 402 does not define."""
    for mask, pattern, state in _PATTERNS:
        if statusword & mask == pattern:
            return state
    return None
