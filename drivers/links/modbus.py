"""Link to the registers of one Modbus unit over any transport.

The link checks every answer, repeats requests if necessary, and writes only to registers on an allow-list.
"""

from __future__ import annotations

import struct
from collections import deque
from collections.abc import Mapping, Sequence
from statistics import median

from drivers.clock import wall_seconds
from drivers.errors import CommandRejected, ConfigurationError, LinkError, LinkLost, LinkTimeout, ProtocolError
from drivers.links.modbus_transport import EXCEPTION_BIT, READ, WRITE, WRITE_AND_READ, DamagedFrame, Transport
from drivers.links.reconnection import LINK_FAILURES, Reconnection

ILLEGAL_FUNCTION = 1
BUSY = 6

_EXCEPTIONS = {
    1: ("illegal function", "the controller does not support this function; see section 1 of the register map"),
    2: ("illegal register address", "compare the register addresses in the configuration with the controller's"),
    3: ("illegal value or count", "the controller accepts only shorter requests than the register map requires"),
    4: ("device failure", "check the controller"),
    5: ("acknowledge, long operation", "the register map has no long operations; check the controller"),
    7: ("negative acknowledge", "check the controller"),
    8: ("memory parity error", "check the controller"),
    10: ("gateway path unavailable", "check the gateway between here and the controller"),
    11: ("gateway target does not answer", "check the unit id, and the line behind the gateway"),
}

_ALTERED = "a byte was altered on the way, or the server does not follow Modbus; check cable, connectors and gateway"
_DECIDED_BY_ADDRESS = (ILLEGAL_FUNCTION, 2, 3)
"""Codes of exceptions that follow from function, address and count of a request alone."""
_KIND_BYTES = {READ: 5, WRITE: 5, WRITE_AND_READ: 9}
"""Number of leading bytes of a request that hold its function, addresses and counts."""


class _ExceptionResponse(Exception):
    def __init__(self, code: int) -> None:
        super().__init__(code)
        self.code = code


class LatencyStatistics:
    """Statistics of the round-trip times of Modbus requests, in seconds of the wall clock."""

    def __init__(self, window: int = 1000) -> None:
        self.count = 0
        self.worst_s = 0.0
        self._recent: deque[float] = deque(maxlen=window)

    def add(self, duration_s: float) -> None:
        self.count += 1
        self.worst_s = max(self.worst_s, duration_s)
        self._recent.append(duration_s)

    @property
    def median_s(self) -> float:
        """Median of the most recent round-trip times in s; 0 if there were none.

        At most `window` round trips are considered (1000 by default).
        """
        return median(self._recent) if self._recent else 0.0


class ModbusLink:
    """Link to one Modbus unit.

    `writable` lists the registers that may be written. A write to any other register is refused before anything is
    sent. A request that the caller declares idempotent is repeated after a timeout or a damaged answer, up to `retries`
    times. On a transport without a checksum, an answer that does not fit the request counts as damaged, and so does the
    refusal of a request whose kind the unit has carried out before: a byte may have been altered on the way. After the
    last repetition, and after a lost connection, such a request is left to `reconnection`, which opens the connection
    again; without it, a lost connection stays closed until `open` is called.

    The methods raise `LinkLost`, `LinkTimeout` or `ProtocolError` (including `DamagedFrame`). Each error names the
    device, the link and the register.
    """

    def __init__(
        self,
        transport: Transport,
        *,
        writable: Sequence[range],
        where: Mapping[str, str],
        retries: int = 1,
        combined: bool = True,
        reconnection: Reconnection | None = None,
    ) -> None:
        self.where = where
        self.transport = transport
        self.latency = LatencyStatistics()
        self.repeat_count = 0
        """Number of requests that were sent again."""
        self._writable = tuple(writable)
        self._retries = retries
        self._combined = combined
        self.reconnection = reconnection
        self._in_use = False
        self.look_only = False
        """True if the link was opened to read only."""
        self._selectors: tuple[range, ...] = ()
        self._loss: LinkLost | None = None
        self._carried_out: set[bytes] = set()
        """Function, addresses and counts of the requests that the unit has carried out."""

    @property
    def connected(self) -> bool:
        return self.transport.connected

    def open(self, *, look_only: bool = False, selectors: Sequence[range] = ()) -> None:
        """Connect. If `look_only` is True, all writes are refused until the link is closed, except to the registers
        `selectors`, which only select what the unit shows."""
        self.transport.open()
        self._in_use, self._loss, self.look_only, self._selectors = True, None, look_only, tuple(selectors)

    def close(self) -> None:
        self._in_use = False
        self.transport.close()

    def _reopen(self) -> None:
        self.transport.close()
        self.transport.open()

    def read(self, register: int, count: int) -> bytes:
        """Read `count` registers with function 3, and return their 2 × `count` bytes."""
        request = struct.pack(">BHH", READ, register, count)
        return self._checked(request, register, idempotent=True)[1:]

    def write(self, register: int, data: bytes, *, idempotent: bool) -> None:
        """Write `data` with function 16 to consecutive registers; the first one is `register`."""
        head = struct.pack(">HH", register, self._writable_count(register, data))
        request = bytes((WRITE,)) + head + bytes((len(data),)) + data
        self._checked(request, register, idempotent=idempotent)

    def exchange(self, register: int, data: bytes, read: int, count: int, *, idempotent: bool) -> bytes:
        """Write `data` starting at `register`, then read `count` registers starting at `read` and return their bytes.

        Function 23 writes and reads in one round trip. If the server does not support function 23, this and all later
        calls use functions 16 and 3 instead.
        """
        if self._combined:
            written = self._writable_count(register, data)
            request = struct.pack(">BHHHHB", WRITE_AND_READ, read, count, register, written, len(data)) + data
            try:
                answer = self._send_with_retries(request, register, idempotent=idempotent)
            except _ExceptionResponse as refusal:
                # A unit that refuses a function has not carried it out, so the two single requests do not write twice.
                if refusal.code != ILLEGAL_FUNCTION:
                    raise self._exception_error(refusal.code, register) from None
            else:
                return answer[1:]
            self._combined = False
        self.write(register, data, idempotent=idempotent)
        return self.read(read, count)

    def exchange_wire_time_s(self, written: int, read: int) -> float:
        """Return the transmission time in s of one call of `exchange`; 0 if the time is unknown.

        `written` and `read` are the numbers of registers written and read.
        """
        if self._combined:
            return self.transport.wire_time_s(
                struct.pack(">BHHHHB", WRITE_AND_READ, 0, read, 0, 0, 0) + bytes(2 * written)
            )
        write = struct.pack(">BHHB", WRITE, 0, written, 0) + bytes(2 * written)
        return self.transport.wire_time_s(write) + self.transport.wire_time_s(struct.pack(">BHH", READ, 0, read))

    def _writable_count(self, register: int, data: bytes) -> int:
        count = len(data) // 2
        allowed = self._selectors if self.look_only else self._writable
        inside = any(register in block and register + count - 1 in block for block in allowed)
        if self.look_only and not inside:
            raise CommandRejected(
                "refused to write over a link that was opened only to read",
                hint="close the device and open it for a run",
                register=register,
                **self.where,
            )
        if not inside:
            raise ConfigurationError(
                "refused to write outside the writable registers",
                hint="the allow-list follows from the block addresses in the configuration",
                register=register,
                **self.where,
            )
        return count

    def _checked(self, request: bytes, register: int, *, idempotent: bool) -> bytes:
        try:
            return self._send_with_retries(request, register, idempotent=idempotent)
        except _ExceptionResponse as refusal:
            raise self._exception_error(refusal.code, register) from None

    def _send_with_retries(self, request: bytes, register: int, *, idempotent: bool) -> bytes:
        if not idempotent:
            return self._send_once(request, register)
        try:
            return self._send_repeatedly(request, register)
        except LINK_FAILURES as failure:
            if self.reconnection is None or not self._in_use:
                raise
            return self.reconnection.repeat(failure, self._reopen, lambda: self._send_repeatedly(request, register))

    def _send_repeatedly(self, request: bytes, register: int) -> bytes:
        # Errors of the last attempt are passed on.
        for _ in range(self._retries):
            try:
                return self._send_once(request, register)
            except (LinkTimeout, DamagedFrame):
                self.repeat_count += 1
        return self._send_once(request, register)

    def _not_connected(self, register: int) -> LinkLost:
        """Return the error of a request without a connection. It names the reason for which an opened link was lost."""
        if self._in_use and self._loss is not None:
            return LinkLost(self._loss.message, hint=self._loss.hint, register=register, **self.where)
        return LinkLost("the link is not open", hint="open the device first", register=register, **self.where)

    def _send_once(self, request: bytes, register: int) -> bytes:
        """Send `request` once and return the answer without its function code.

        Raises `_ExceptionResponse` if the unit answers with a Modbus exception.
        """
        if not self.connected:
            raise self._not_connected(register)
        started_s = wall_seconds()
        try:
            answer = self.transport.ask(request)
        except LinkError as error:
            error.where = {"register": str(register), **error.where}
            if isinstance(error, LinkLost):
                self._loss = error
            raise
        self.latency.add(wall_seconds() - started_s)
        kind = request[: _KIND_BYTES[request[0]]]
        # An exception response is the function code with the highest bit set, and a code.
        if answer[0] == request[0] | EXCEPTION_BIT and len(answer) == 2:
            if answer[1] == BUSY:
                raise LinkTimeout("the controller is busy", register=register, **self.where)
            if answer[1] not in _EXCEPTIONS and not self.transport.has_checksum:
                raise self._misfit(f"unknown Modbus exception {answer[1]}", register)
            if answer[1] in _DECIDED_BY_ADDRESS and kind in self._carried_out and not self.transport.has_checksum:
                name = _EXCEPTIONS[answer[1]][0]
                raise self._misfit(
                    f"a request that was carried out before is refused: Modbus exception {answer[1]}, {name}", register
                )
            raise _ExceptionResponse(answer[1])
        if answer[0] != request[0]:
            raise self._misfit(f"a request with function {request[0]} was answered with function {answer[0]}", register)
        self._require_fit(request, answer, register)
        self._carried_out.add(kind)
        return answer[1:]

    def _require_fit(self, request: bytes, answer: bytes, register: int) -> None:
        """Raise DamagedFrame if the answer does not have the form that its request asks for."""
        if request[0] == WRITE:
            if answer != request[:5]:
                raise self._misfit("the answer to a write names other registers", register)
            return
        count = int.from_bytes(request[3:5], "big")
        if len(answer) != 2 * count + 2 or answer[1] != 2 * count:
            raise self._misfit(
                f"requested {count} registers, but the answer holds {max(len(answer) - 2, 0)} bytes", register
            )

    def _misfit(self, text: str, register: int) -> ProtocolError:
        """Return the error of an answer that does not fit its request. Without a checksum, it may have been altered on
        the way."""
        if self.transport.has_checksum:
            return ProtocolError(text, register=register, **self.where)
        return DamagedFrame(text, hint=_ALTERED, register=register, **self.where)

    def _exception_error(self, code: int, register: int) -> ProtocolError:
        name, hint = _EXCEPTIONS.get(code, ("unknown", "check the controller"))
        return ProtocolError(f"Modbus exception {code}, {name}", hint=hint, register=register, **self.where)
