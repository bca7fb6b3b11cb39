"""Modbus RTU frames received by a controller. The module finds the end of a request and checks its validity.

Source: MODBUS over Serial Line Specification V1.02, 2.5.1.1 and 6.2.2. The CRC is computed bit by bit as in 6.2.2.
"""

from __future__ import annotations

from typing import Final

from simulators.wire.modbus.frames import READ, WRITE, WRITE_AND_READ

CRC_BYTES: Final = 2
SHORTEST: Final = 4
LONGEST: Final = 256
_BYTE_COUNT_AT: Final = {WRITE: 6, WRITE_AND_READ: 10}


class InvalidFrameError(Exception):
    """Error for received data that is not a valid request. A controller does not answer such data."""


def frame_crc(data: bytes) -> bytes:
    """Return the CRC-16 of a Modbus RTU frame as two bytes, low byte first."""
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
    """Remove the request at the front of `buffer`, and return its unit address and the bytes between unit address and
    CRC.

    Returns None if the request is incomplete. If the bytes cannot become a valid request, the buffer is emptied and
    InvalidFrameError is raised.
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
    """Return the length of the frame, or None if not yet known.

    For an unknown function, all bytes received so far count.
    """
    if len(buffer) < SHORTEST:
        return None
    function = buffer[1]
    if function == READ:
        return 8
    at = _BYTE_COUNT_AT.get(function)
    if at is None:
        return len(buffer)
    return at + 1 + buffer[at] + CRC_BYTES if len(buffer) > at else None
