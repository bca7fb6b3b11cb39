"""Modbus register map from the side of the controller: blocks, codes, and the layout of each block.

Source: docs/reference/modbus-register-map.md, sections 2 to 5, 8 and 9. The module is written from that page of the
documentation and not from the agent's driver, because an error in a shared map, such as a swapped word, would not be
noticed.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from enum import IntEnum
from typing import Final

PROTOCOL: Final = 0x5643
VERSION: Final = 0x0100
NO_BANK_PENDING: Final = 0xFFFF
NO_SUCH_BLOCK: Final = 0xFFFF
NO_TEMPERATURE: Final = -0x80000000
TEMPERATURE_SLOTS: Final = 8


@dataclass(frozen=True)
class RegisterBlock:
    """Block of consecutive holding registers, from `address`. A request must stay inside one block."""

    address: int
    registers: int
    writable: bool

    def holds(self, address: int, count: int) -> bool:
        return self.address <= address and address + count <= self.address + self.registers

    def slice_of(self, address: int, count: int) -> slice:
        """Return the slice of the block's bytes that holds `count` registers from `address`."""
        start = 2 * (address - self.address)
        return slice(start, start + 2 * count)


STATUS = RegisterBlock(1000, 70, writable=False)
LIMITS = RegisterBlock(1100, 63, writable=False)
READ_WINDOW = RegisterBlock(1200, 122, writable=False)
COMMAND = RegisterBlock(2000, 23, writable=True)
DESCRIPTOR = RegisterBlock(2100, 34, writable=True)
DATA_WINDOW = RegisterBlock(2200, 121, writable=True)
READ_SELECTOR = RegisterBlock(2400, 2, writable=True)

SEQUENCE_REGISTER: Final = 2022
BLOCK_NUMBER_REGISTER: Final = 2320


class ModbusExceptionCode(IntEnum):
    """Exception codes (docs/reference/modbus-register-map.md, section 1) with which the simulator answers; code 4 is
    never needed.
    """

    FUNCTION_NOT_OFFERED = 1
    ILLEGAL_ADDRESS = 2
    WRONG_COUNT = 3


class ModbusCommandCode(IntEnum):
    """Command codes (docs/reference/modbus-register-map.md, section 5)."""

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


MOTION_COMMANDS: Final = frozenset(
    {
        ModbusCommandCode.MOVE_RAPID,
        ModbusCommandCode.MOVE_FEED,
        ModbusCommandCode.GUARDED_RAPID,
        ModbusCommandCode.GUARDED_FEED,
        ModbusCommandCode.TOUCH,
    }
)


class ModbusState(IntEnum):
    """Machine states (register 1004 of the Modbus register map)."""

    IDLE = 0
    MOVING = 1
    HELD = 2
    FAULT = 3


class FaultCode(IntEnum):
    """Fault codes (docs/reference/modbus-register-map.md, table 9.1)."""

    NONE = 0
    EMERGENCY_STOP = 1
    END_OF_TRAVEL = 2
    FOLLOWING_ERROR = 3
    DRIVE = 4
    PROBE_TRIPPED = 5
    HEARTBEAT_LOST = 6
    DOOR_OPENED = 7
    PERMISSION_LOST = 8
    PROBE_LOST = 9
    COLLISION = 10
    OTHER = 99


class ResultCode(IntEnum):
    """Command results (docs/reference/modbus-register-map.md, table 9.2)."""

    NONE_YET = 0
    ACCEPTED = 1
    UNKNOWN_COMMAND = 2
    NOT_IN_THIS_STATE = 3
    PERMISSION_MISSING = 4
    OUTSIDE_TRAVEL = 5
    ILLEGAL_FEED = 6
    ILLEGAL_VALUE = 7
    NO_PROBE = 8
    CAUSE_PRESENT = 9
    PROBE_DEFLECTED = 10
    NO_SUCH_BANK = 20
    BANK_IN_USE = 21
    DESCRIPTOR_NOT_ALLOWED = 22
    BLOCKS_MISSING = 23
    CRC_DIFFERS = 24
    NOT_ARMED = 25
    NOT_COMPLETE = 26
    NO_TRANSFER = 27


class ModbusOutcome(IntEnum):
    """Motion outcomes (docs/reference/modbus-register-map.md, table 9.3)."""

    NONE = 0
    UNDER_WAY = 1
    IN_POSITION = 2
    TRIPPED = 3
    MISSED = 4
    GUARD_TRIPPED = 5
    STOPPED = 6
    HEARTBEAT_LOST = 7
    FAULT = 8


class LatchResult(IntEnum):
    """Latch results: whether the probe tripped in a touch (register 1025 of the Modbus register map)."""

    NONE = 0
    TRIPPED = 1
    MISSED = 2


class ModbusBankState(IntEnum):
    """States of a compensation bank (registers 1046 and 1047 of the Modbus register map)."""

    EMPTY = 0
    BEING_WRITTEN = 1
    COMPLETE = 2
    DAMAGED = 3


STATUS_LAYOUT = struct.Struct(">12H 24s 2H 24s 10H 2I H 8i H")
"""Layout of STATUS: 1000–1011, actual position, latch sequence and result, latched position, 1038–1047, both CRCs,
temperature count, temperatures, heartbeat copy.
"""

LIMITS_LAYOUT = struct.Struct(">96s 4H I 16s H")
"""Layout of LIMITS: travel, rapid and acceleration (12 numbers), banks and maximum nodes per axis, maximum nodes in
total, resolution and largest correction (2 numbers), activation.
"""

COMMAND_LAYOUT = struct.Struct(">4H I 24s 8s H")
"""Layout of COMMAND: agent heartbeat, command, bank, nonce, CRC, target, feed, sequence."""

DESCRIPTOR_LAYOUT = struct.Struct(">4H 56s I")
"""Layout of DESCRIPTOR: bank, nx, ny, nz, origin, step and resolution (7 numbers), CRC."""
