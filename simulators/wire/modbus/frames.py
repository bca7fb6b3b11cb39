"""Modbus TCP framing. The received stream is split into requests, and the Modbus functions 3, 16 and 23 act on a set of
registers.

Sources: MODBUS Messaging on TCP/IP Implementation Guide V1.0b (Modbus application protocol (MBAP) header, 3.1.3);
MODBUS Application Protocol V1.1b3 (functions 3, 16 and 23: 6.3, 6.12, 6.17); docs/reference/modbus-register-map.md,
section 1.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from typing import Final, Protocol

from simulators.wire.modbus.register_map import ModbusExceptionCode

READ: Final = 3
WRITE: Final = 16
WRITE_AND_READ: Final = 23
MAX_READ: Final = 125
MAX_WRITTEN: Final = 121
LONGEST_PDU: Final = 253
HEADER = struct.Struct(">HHHB")
_TWO_WORDS = struct.Struct(">HH")
_FOUR_WORDS = struct.Struct(">HHHH")


class RegisterAccessError(Exception):
    """Error for a refused access to registers. The client receives it as an exception response."""

    def __init__(self, code: ModbusExceptionCode) -> None:
        super().__init__(code.name)
        self.code = code


class Registers(Protocol):
    """Interface of registers that requests read and write as bytes, with the high byte of each register first.

    Each method may raise RegisterAccessError.
    """

    def check_read(self, address: int, count: int) -> None: ...

    def check_write(self, address: int, count: int) -> None: ...

    def read(self, address: int, count: int) -> bytes: ...

    def write(self, address: int, data: bytes) -> None: ...


class ModbusFramingError(Exception):
    """Error for received data that is not Modbus TCP. The connection must then be closed."""


def split_frames(buffer: bytearray) -> Iterator[tuple[int, int, bytes]]:
    """Remove every complete frame from the front of `buffer`. Yields the transaction id, unit id and request of each
    frame.

    Raises ModbusFramingError if the start of a frame is not a Modbus TCP header.
    """
    while len(buffer) >= HEADER.size:
        transaction, protocol, length, unit = HEADER.unpack_from(buffer)
        if protocol != 0 or not 2 <= length <= LONGEST_PDU + 1:
            raise ModbusFramingError(f"MBAP header {bytes(buffer[: HEADER.size]).hex(' ')}")
        end = HEADER.size - 1 + length
        if len(buffer) < end:
            return
        request = bytes(buffer[HEADER.size : end])
        del buffer[:end]
        yield transaction, unit, request


def frame(transaction: int, unit: int, answer: bytes) -> bytes:
    return HEADER.pack(transaction, 0, len(answer) + 1, unit) + answer


def answer_request(request: bytes, registers: Registers) -> bytes:
    """Return the response to one request. An exception response is returned if the access is refused.

    The request and the response start with the function code.
    """
    function = request[0]
    try:
        if function == READ:
            return _read(request, registers)
        if function == WRITE:
            return _write(request, registers)
        if function == WRITE_AND_READ:
            return _write_and_read(request, registers)
        raise RegisterAccessError(ModbusExceptionCode.FUNCTION_NOT_OFFERED)
    except RegisterAccessError as refusal:
        return bytes((function | 0x80, refusal.code))


def _read(request: bytes, registers: Registers) -> bytes:
    _require(len(request) == 5)
    address, count = _TWO_WORDS.unpack_from(request, 1)
    _require(1 <= count <= MAX_READ)
    registers.check_read(address, count)
    return bytes((READ, 2 * count)) + registers.read(address, count)


def _write(request: bytes, registers: Registers) -> bytes:
    _require(len(request) >= 6)
    address, count = _TWO_WORDS.unpack_from(request, 1)
    _require_data(request, 6, count)
    registers.check_write(address, count)
    registers.write(address, request[6:])
    return request[:5]


def _write_and_read(request: bytes, registers: Registers) -> bytes:
    """Execute function 23: write, then read. Nothing is written if either half is refused."""
    _require(len(request) >= 10)
    read_address, read_count, address, count = _FOUR_WORDS.unpack_from(request, 1)
    _require(1 <= read_count <= MAX_READ)
    _require_data(request, 10, count)
    registers.check_read(read_address, read_count)
    registers.check_write(address, count)
    registers.write(address, request[10:])
    return bytes((WRITE_AND_READ, 2 * read_count)) + registers.read(read_address, read_count)


def _require_data(request: bytes, start: int, count: int) -> None:
    """Require that register count, byte count (the byte before `start`) and number of bytes received agree."""
    _require(1 <= count <= MAX_WRITTEN and request[start - 1] == 2 * count == len(request) - start)


def _require(holds: bool) -> None:
    if not holds:
        raise RegisterAccessError(ModbusExceptionCode.WRONG_COUNT)
