"""Objects of CiA 301 and CiA 402 that the rotary mount uses, with their data types."""

from __future__ import annotations

import struct
from dataclasses import dataclass


@dataclass(frozen=True)
class DriveObject:
    """Object in the object dictionary of a drive.

    `code` is the `struct` letter of its little-endian integer type: B/b for 8, H/h for 16, I/i for 32 bits.
    """

    index: int
    subindex: int
    code: str
    name: str

    @property
    def size(self) -> int:
        return struct.calcsize("<" + self.code)

    def pack(self, value: int) -> bytes:
        return struct.pack("<" + self.code, value)

    def unpack(self, data: bytes) -> int:
        return int(struct.unpack("<" + self.code, data)[0])

    def __str__(self) -> str:
        return f"0x{self.index:04X}:{self.subindex:02X} {self.name}"


DEVICE_TYPE = DriveObject(0x1000, 0, "I", "device type")
LAST_ERROR = DriveObject(0x1003, 1, "I", "pre-defined error field")
DEVICE_NAME, HARDWARE_VERSION, SOFTWARE_VERSION = 0x1008, 0x1009, 0x100A
"""Indexes of visible strings; all three are optional in CiA 301."""
WATCHED_HEARTBEAT = DriveObject(0x1016, 1, "I", "consumer heartbeat time")
HEARTBEAT_TIME = DriveObject(0x1017, 0, "H", "producer heartbeat time")
VENDOR_ID = DriveObject(0x1018, 1, "I", "vendor id")
PRODUCT_CODE = DriveObject(0x1018, 2, "I", "product code")
REVISION = DriveObject(0x1018, 3, "I", "revision number")
SERIAL_NUMBER = DriveObject(0x1018, 4, "I", "serial number")
ERROR_CODE = DriveObject(0x603F, 0, "H", "error code")
CONTROLWORD = DriveObject(0x6040, 0, "H", "controlword")
STATUSWORD = DriveObject(0x6041, 0, "H", "statusword")
MODE = DriveObject(0x6060, 0, "b", "modes of operation")
MODE_DISPLAY = DriveObject(0x6061, 0, "b", "modes of operation display")
POSITION = DriveObject(0x6064, 0, "i", "position actual value")
TARGET_POSITION = DriveObject(0x607A, 0, "i", "target position")
DC_LINK_MV = DriveObject(0x6079, 0, "I", "DC link circuit voltage")
LOWER_LIMIT = DriveObject(0x607D, 1, "i", "software position limit, lower")
UPPER_LIMIT = DriveObject(0x607D, 2, "i", "software position limit, upper")
POLARITY = DriveObject(0x607E, 0, "B", "polarity")
PROFILE_VELOCITY = DriveObject(0x6081, 0, "I", "profile velocity")
PROFILE_ACCELERATION = DriveObject(0x6083, 0, "I", "profile acceleration")
PROFILE_DECELERATION = DriveObject(0x6084, 0, "I", "profile deceleration")
ENCODER_INCREMENTS = DriveObject(0x608F, 1, "I", "encoder increments")
ENCODER_MOTOR_TURNS = DriveObject(0x608F, 2, "I", "motor revolutions")
GEAR_MOTOR_TURNS = DriveObject(0x6091, 1, "I", "motor revolutions")
GEAR_SHAFT_TURNS = DriveObject(0x6091, 2, "I", "shaft revolutions")
FEED = DriveObject(0x6092, 1, "I", "feed")
FEED_SHAFT_TURNS = DriveObject(0x6092, 2, "I", "shaft revolutions")
HOMING_METHOD = DriveObject(0x6098, 0, "b", "homing method")
HOMING_SEARCH_SPEED = DriveObject(0x6099, 1, "I", "homing speed, search for switch")
HOMING_LATCH_SPEED = DriveObject(0x6099, 2, "I", "homing speed, search for zero")
HOMING_ACCELERATION = DriveObject(0x609A, 0, "I", "homing acceleration")
POSITION_UNIT = DriveObject(0x60A8, 0, "I", "SI unit position")
VELOCITY_UNIT = DriveObject(0x60A9, 0, "I", "SI unit velocity")
FOLLOWING_DISTANCE = DriveObject(0x60F4, 0, "i", "following error actual value")
DIGITAL_INPUTS = DriveObject(0x60FD, 0, "I", "digital inputs")
SUPPORTED_MODES = DriveObject(0x6502, 0, "I", "supported drive modes")

PROFILE_POSITION = 1
HOMING = 6

READ = (STATUSWORD, MODE_DISPLAY, POSITION)
WRITTEN = (CONTROLWORD, MODE, TARGET_POSITION, PROFILE_VELOCITY)
"""Objects that the EDS of a usable drive must list: `READ`, and `WRITTEN` as writable.

The ramps (0x6083, 0x6084) are not required, because CiA 402 makes them optional.
"""
WRITTEN_FOR_HOMING = (HOMING_METHOD, HOMING_SEARCH_SPEED, HOMING_LATCH_SPEED, HOMING_ACCELERATION)

CIA_402 = 402
"""Device profile number of a drive: the low 16 bits of its device type (0x1000)."""


def mode_bit(mode: int) -> int:
    """Return the bit mask of an operating mode in object 0x6502 (supported modes).

    Mode 1 has bit 0, and mode 6 has bit 5.
    """
    return 1 << (mode - 1)
