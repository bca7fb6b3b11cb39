"""Modbus RTU frames as a controller sees them: where a request ends, and whether it is sound.

Source: MODBUS over Serial Line Specification V1.02, 2.5.1.1 and 6.2.2 (CRC generation, written bit by bit as there).
"""

from __future__ import annotations

from typing import Final

from simulators.wire.modbus.frames import READ, WRITE, WRITE_AND_READ

CRC_BYTES: Final = 2
SHORTEST: Final = 4
LONGEST: Final = 256
_BYTE_COUNT_AT: Final = {WRITE: 6, WRITE_AND_READ: 10}


class InvalidFrameError(Exception):
    """What came is no sound request; a controller says nothing to it."""


def frame_crc(data: bytes) -> bytes:
    """Both bytes, low one first."""
    register = 0xFFFF
    for byte in data:
        register ^= byte
        for _ in range(8):
            carried = register & 1
            register >>= 1
            if carried:
                register ^= 0xA001
    return register.to_bytes(CRC_BYTES, "little")


def take_request(buffer: bytearray) -> tuple[int, bytes] | None:
    """The request at the front of `buffer`, taken off it: unit, and what stands between unit and CRC.

    None while more must come. Raises NoFrame, the buffer emptied, where no sound frame can come of it.
    """
    length = _length(buffer)
    if length is None or len(buffer) < length:
        return None
    frame = bytes(buffer[:length])
    if length > LONGEST or frame_crc(frame[:-CRC_BYTES]) != frame[-CRC_BYTES:]:
        garbage = bytes(buffer)
        buffer.clear()
        raise InvalidFrameError(garbage.hex(" "))
    del buffer[:length]
    return frame[0], frame[1:-CRC_BYTES]


def answer_frame(unit: int, answer: bytes) -> bytes:
    frame = bytes((unit,)) + answer
    return frame + frame_crc(frame)


def _length(buffer: bytearray) -> int | None:
    """Of a function that is not known the frame is all that came at once."""
    if len(buffer) < SHORTEST:
        return None
    function = buffer[1]
    if function == READ:
        return 8
    at = _BYTE_COUNT_AT.get(function)
    if at is None:
        return len(buffer)
    return at + 1 + buffer[at] + CRC_BYTES if len(buffer) > at else None
