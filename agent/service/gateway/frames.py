"""Modbus TCP requests. They are decoded, executed on a set of registers and coils, and answered with an encoded
response.

Sources: MODBUS Messaging on TCP/IP Implementation Guide V1.0b (MBAP header in section 3.1.3); MODBUS Application
Protocol V1.1b3 (function codes in sections 6.1, 6.3 to 6.6, 6.11 and 6.12, exception codes in section 7).
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Sequence
from enum import IntEnum
from typing import Final, Protocol

HEADER: Final = struct.Struct(">HHHB")
MAX_PDU_BYTES: Final = 253
MAX_REGISTERS_READ: Final = 125
MAX_REGISTERS_WRITTEN: Final = 123
MAX_COILS_READ: Final = 2000
MAX_COILS_WRITTEN: Final = 1968
_PAIR = struct.Struct(">HH")
_COIL_ON, _COIL_OFF = 0xFF00, 0x0000


class Function(IntEnum):
    READ_COILS = 1
    READ_HOLDING = 3
    READ_INPUT = 4
    WRITE_COIL = 5
    WRITE_REGISTER = 6
    WRITE_COILS = 15
    WRITE_REGISTERS = 16


class ExceptionCode(IntEnum):
    FUNCTION = 1
    ADDRESS = 2
    VALUE = 3
    FAILURE = 4


class RegisterError(Exception):
    """Error raised if a request cannot be executed. The client receives a Modbus exception response."""

    def __init__(self, code: ExceptionCode) -> None:
        super().__init__(code.name)
        self.code = code


class FramingError(Exception):
    """Error raised if the received bytes are not Modbus TCP. The connection must then be closed."""


class RegisterTable(Protocol):
    """Interface of the registers and coils that requests read and write. If a method raises RegisterError, the
    registers and coils are unchanged."""

    def read(self, address: int, count: int) -> Sequence[int]: ...

    def write(self, address: int, words: Sequence[int]) -> None: ...

    def read_coils(self, address: int, count: int) -> Sequence[bool]: ...

    def write_coils(self, address: int, states: Sequence[bool]) -> None: ...


def body_length(header: bytes) -> int:
    """Return the number of bytes that follow the 7-byte header of a request. Raise FramingError if these 7 bytes are
    not a Modbus TCP header."""
    _, protocol, length, _ = HEADER.unpack(header)
    if protocol != 0 or not 2 <= length <= MAX_PDU_BYTES + 1:
        raise FramingError(f"MBAP header {header.hex(' ')}")
    return int(length) - 1


def answer_frame(header: bytes, answer: bytes) -> bytes:
    """Return the response frame that contains `answer`, the response PDU (protocol data unit). The transaction and unit
    numbers are those of `header`, the header of the request."""
    transaction, _, _, unit = HEADER.unpack(header)
    return HEADER.pack(transaction, 0, len(answer) + 1, unit) + answer


def answer_request(request: bytes, table: RegisterTable) -> bytes:
    """Return the response PDU (protocol data unit: function code and data) for one request PDU. The response may be an
    exception response."""
    function = request[0]
    try:
        if function not in _ANSWERS:
            raise RegisterError(ExceptionCode.FUNCTION)
        return bytes((function,)) + _ANSWERS[function](request, table)
    except RegisterError as refusal:
        return bytes((function | 0x80, refusal.code))


def _read_registers(request: bytes, table: RegisterTable) -> bytes:
    address, count = _range(request, MAX_REGISTERS_READ, exact=True)
    words = table.read(address, count)
    return bytes((2 * count,)) + struct.pack(f">{count}H", *words)


def _read_coils(request: bytes, table: RegisterTable) -> bytes:
    address, count = _range(request, MAX_COILS_READ, exact=True)
    bits = sum(1 << place for place, on in enumerate(table.read_coils(address, count)) if on)
    size = (count + 7) // 8
    return bytes((size,)) + bits.to_bytes(size, "little")


def _write_register(request: bytes, table: RegisterTable) -> bytes:
    _require(len(request) == 5)
    address, word = _PAIR.unpack_from(request, 1)
    table.write(address, (word,))
    return request[1:]


def _write_coil(request: bytes, table: RegisterTable) -> bytes:
    _require(len(request) == 5)
    address, value = _PAIR.unpack_from(request, 1)
    _require(value in (_COIL_ON, _COIL_OFF))
    table.write_coils(address, (value == _COIL_ON,))
    return request[1:]


def _write_registers(request: bytes, table: RegisterTable) -> bytes:
    address, count = _range(request, MAX_REGISTERS_WRITTEN)
    _require(request[5] == 2 * count == len(request) - 6)
    table.write(address, struct.unpack_from(f">{count}H", request, 6))
    return request[1:5]


def _write_coils(request: bytes, table: RegisterTable) -> bytes:
    address, count = _range(request, MAX_COILS_WRITTEN)
    _require(request[5] == (count + 7) // 8 == len(request) - 6)
    bits = int.from_bytes(request[6:], "little")
    table.write_coils(address, [bool(bits >> place & 1) for place in range(count)])
    return request[1:5]


_ANSWERS: Final[dict[int, Callable[[bytes, RegisterTable], bytes]]] = {
    Function.READ_COILS: _read_coils,
    Function.READ_HOLDING: _read_registers,
    Function.READ_INPUT: _read_registers,
    Function.WRITE_COIL: _write_coil,
    Function.WRITE_REGISTER: _write_register,
    Function.WRITE_COILS: _write_coils,
    Function.WRITE_REGISTERS: _write_registers,
}


def _range(request: bytes, most: int, *, exact: bool = False) -> tuple[int, int]:
    """Return the address and count of a request. If `exact`, the request must end after them; otherwise a byte count
    and data must follow. Raise RegisterError if the length is wrong or if the count is not from 1 to `most`.
    """
    _require(len(request) == 5 if exact else len(request) > 6)
    address, count = _PAIR.unpack_from(request, 1)
    _require(1 <= count <= most)
    return address, count


def _require(holds: bool) -> None:
    if not holds:
        raise RegisterError(ExceptionCode.VALUE)
