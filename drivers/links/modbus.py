"""A thin synchronous Modbus TCP link over pymodbus 3.16, the only module that imports it.

Register contents travel as bytes, big-endian within a register, so that a block is packed and unpacked with
one `struct` call above. pymodbus' own register messages do that register by register, which costs as much as
the whole round trip (70 registers over loopback: 96 µs against 59 µs, measured); hence messages of our own,
handed to `ModbusTcpClient.register` and `execute`.
"""

from __future__ import annotations

import logging
import struct
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from statistics import median
from typing import Protocol, cast

from pymodbus.client import ModbusTcpClient
from pymodbus.exceptions import ConnectionException, ModbusException, ModbusIOException
from pymodbus.pdu import ExceptionResponse, ModbusPDU

from drivers.clock import wall_seconds
from drivers.errors import ConfigurationError, LinkError, LinkLost, LinkTimeout, ProtocolError

READ, WRITE, WRITE_AND_READ = 3, 16, 23
ILLEGAL_FUNCTION = 1
BUSY = 6

_EXCEPTIONS = {
    1: "illegal function",
    2: "illegal register address",
    3: "illegal value or count",
    4: "device failure",
    5: "acknowledge, long operation",
    6: "device busy",
    8: "memory parity error",
    10: "gateway path unavailable",
    11: "gateway target does not answer",
}

# Every pymodbus log record is followed by a typed error here; without this the last-resort handler of
# logging would print it to stderr as well.
logging.getLogger("pymodbus").addHandler(logging.NullHandler())


class _Request(ModbusPDU):
    """A request whose body is packed already."""

    def __init__(self, function_code: int, body: bytes, unit: int) -> None:
        super().__init__(dev_id=unit)
        self.function_code = function_code
        self._body = body

    def encode(self) -> bytes:
        return self._body


class _Response(ModbusPDU):
    """An answer kept as bytes; what it must look like is decided by the one who asked."""

    payload: bytes = b""

    def decode(self, data: bytes) -> None:
        self.payload = data


class _ReadResponse(_Response):
    function_code = 3
    rtu_byte_count_pos = 2


class _WriteResponse(_Response):
    function_code = 16
    rtu_frame_size = 8


class _WriteAndReadResponse(_Response):
    function_code = 23
    rtu_byte_count_pos = 2


class _Client(Protocol):
    """What is used of pymodbus' client, with the annotations that it lacks."""

    @property
    def connected(self) -> bool: ...

    def connect(self) -> bool: ...

    def close(self) -> None: ...

    def register(self, custom_response_class: type[ModbusPDU]) -> None: ...

    def execute(self, no_response_expected: bool, request: ModbusPDU) -> ModbusPDU: ...


class _Refused(Exception):
    def __init__(self, code: int) -> None:
        super().__init__(code)
        self.code = code


class Latency:
    """Round trips as seen from here, wall-clock seconds."""

    def __init__(self, window: int = 1000) -> None:
        self.count = 0
        self.total_s = 0.0
        self.worst_s = 0.0
        self._recent: deque[float] = deque(maxlen=window)

    def add(self, duration_s: float) -> None:
        self.count += 1
        self.total_s += duration_s
        self.worst_s = max(self.worst_s, duration_s)
        self._recent.append(duration_s)

    @property
    def median_s(self) -> float:
        """Of the last thousand; 0 before the first."""
        return median(self._recent) if self._recent else 0.0


@dataclass(frozen=True)
class Endpoint:
    """Where a Modbus TCP server is reached."""

    host: str
    port: int
    unit: int

    def __str__(self) -> str:
        return f"modbus-tcp {self.host}:{self.port} unit {self.unit}"


class ModbusLink:
    """One connection to one unit.

    `writable` lists the registers that may be written; anything else is refused before it reaches the wire.
    Requests declared idempotent are sent again after a timeout, `retries` times; a lost connection is never
    reopened behind the caller's back. Raises `LinkLost`, `LinkTimeout`, `ProtocolError`, each naming the
    device, the link and the register.
    """

    def __init__(
        self,
        endpoint: Endpoint,
        *,
        writable: Sequence[range],
        timeout_s: float = 0.5,
        retries: int = 1,
        device: str = "",
        combined: bool = True,
    ) -> None:
        self.where: dict[str, str] = {"device": device} if device else {}
        self.where["link"] = str(endpoint)
        self.latency = Latency()
        self._unit = endpoint.unit
        self._writable = tuple(writable)
        self._retries = retries
        self._combined = combined
        self._timeout_s = timeout_s
        client = ModbusTcpClient(endpoint.host, port=endpoint.port, timeout=timeout_s, retries=0)
        self._client = cast(_Client, client)
        for response in (_ReadResponse, _WriteResponse, _WriteAndReadResponse):
            self._client.register(response)

    @property
    def connected(self) -> bool:
        return self._client.connected

    def open(self) -> None:
        if not self._client.connect():
            raise LinkLost(
                "no connection to the Modbus server",
                hint="check the address, the cable and that the controller's Modbus server is running",
                **self.where,
            )

    def close(self) -> None:
        self._client.close()

    def read(self, register: int, count: int) -> bytes:
        """Function 3. Returns 2 × `count` bytes."""
        body = struct.pack(">HH", register, count)
        return self._registers(self._checked(READ, body, register, idempotent=True), count, register)

    def write(self, register: int, data: bytes, *, idempotent: bool) -> None:
        """Function 16."""
        count = self._writable_count(register, data)
        head = struct.pack(">HH", register, count)
        answer = self._checked(WRITE, head + struct.pack(">B", len(data)) + data, register, idempotent=idempotent)
        if answer != head:
            raise ProtocolError("write answered for other registers", register=register, **self.where)

    def exchange(self, register: int, data: bytes, read: int, count: int, *, idempotent: bool) -> bytes:
        """Write `data` at `register`, then read `count` registers at `read`; one round trip with function 23.

        A server without function 23 gets 16 and 3 instead, from then on.
        """
        if self._combined:
            written = self._writable_count(register, data)
            body = struct.pack(">HHHHB", read, count, register, written, len(data)) + data
            try:
                answer = self._repeatedly(WRITE_AND_READ, body, register, idempotent=idempotent)
            except _Refused as refusal:
                if refusal.code != ILLEGAL_FUNCTION:
                    raise self._exception_error(refusal.code, register) from None
            else:
                return self._registers(answer, count, read)
            self._combined = False
        self.write(register, data, idempotent=idempotent)
        return self.read(read, count)

    def _writable_count(self, register: int, data: bytes) -> int:
        count = len(data) // 2
        if not any(register in block and register + count - 1 in block for block in self._writable):
            raise ConfigurationError(
                "write outside the registers that may be written",
                hint="the allow-list follows from the block addresses in the configuration",
                register=register,
                **self.where,
            )
        return count

    def _registers(self, answer: bytes, count: int, register: int) -> bytes:
        if len(answer) != 2 * count + 1 or answer[0] != 2 * count:
            raise ProtocolError(
                f"asked for {count} registers, answer holds {max(len(answer) - 1, 0)} bytes",
                register=register,
                **self.where,
            )
        return answer[1:]

    def _checked(self, function: int, body: bytes, register: int, *, idempotent: bool) -> bytes:
        try:
            return self._repeatedly(function, body, register, idempotent=idempotent)
        except _Refused as refusal:
            raise self._exception_error(refusal.code, register) from None

    def _repeatedly(self, function: int, body: bytes, register: int, *, idempotent: bool) -> bytes:
        for _ in range(self._retries if idempotent else 0):
            try:
                return self._once(function, body, register)
            except LinkTimeout:
                continue
        return self._once(function, body, register)

    def _once(self, function: int, body: bytes, register: int) -> bytes:
        """The answer without its function code; raises `_Refused` for an exception response."""
        if not self.connected:
            raise LinkLost("link is not open", hint="open the device first", register=register, **self.where)
        started_s = wall_seconds()
        try:
            answer = self._client.execute(False, _Request(function, body, self._unit))
        except (ConnectionException, OSError) as error:
            self.close()
            raise LinkLost(
                f"connection lost: {error}",
                hint="check the cable and that the controller is on",
                register=register,
                **self.where,
            ) from error
        except ModbusException as error:
            raise self._io_error(error, register) from error
        self.latency.add(wall_seconds() - started_s)
        if isinstance(answer, ExceptionResponse):
            if answer.exception_code == BUSY:
                raise LinkTimeout("controller is busy", register=register, **self.where)
            raise _Refused(answer.exception_code)
        if not isinstance(answer, _Response) or answer.function_code != function:
            raise ProtocolError(
                f"function {function} answered with function {answer.function_code}",
                register=register,
                **self.where,
            )
        return answer.payload

    def _io_error(self, error: ModbusException, register: int) -> LinkError:
        # A timeout carries the function code of its request, an answer that cannot be decoded carries none.
        if isinstance(error, ModbusIOException) and error.fcode is not None:
            return LinkTimeout(
                f"no answer within {self._timeout_s:g} s",
                hint="check unit id, cable and the load of the controller",
                register=register,
                **self.where,
            )
        return ProtocolError(f"answer cannot be decoded: {error}", register=register, **self.where)

    def _exception_error(self, code: int, register: int) -> ProtocolError:
        name = _EXCEPTIONS.get(code, "unknown")
        return ProtocolError(
            f"Modbus exception {code}, {name}",
            hint="compare the register addresses in the configuration with those of the controller",
            register=register,
            **self.where,
        )
