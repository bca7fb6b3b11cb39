"""Modbus RTU on a serial line, over pyserial.

This module does not use pymodbus, because pymodbus makes a bad line look like a dead controller: it searches for a
frame anywhere in the received bytes, silently skips an answer of another unit, and reports a garbled answer as a
timeout.

RTU frames have no transaction number. Before each request, received bytes are discarded. After a failed request, bytes
are also read and discarded until the line is quiet. An answer that arrives even later is accepted as the answer to the
next request if it has the right form. The register map of the controller contains numbers (sequence, block, latch) by
which the caller detects such an outdated answer.

Measured on the clock that the transport is given, a request takes at least its transmission time on a real cable. If
the transfer itself is faster (pseudo-terminal, lockstep clock), the transport sleeps for the rest of that time.
"""

from __future__ import annotations

import select
import termios
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import serial

from drivers.clock import Clock, wall_seconds, without_interrupts
from drivers.errors import LinkLost, LinkTimeout, ProtocolError
from drivers.foreign_errors import cause_of
from drivers.links.modbus_serial_line import ADDRESS_AND_CRC, SerialLine, build_frame, has_valid_crc
from drivers.links.modbus_transport import EXCEPTION_BIT, READ, WRITE, WRITE_AND_READ, DamagedFrame, answer_length

QUIET_S = 0.02
"""Silence in s that ends a frame of unknown length.

It is longer than the gaps that adapters and schedulers insert within a frame.
"""

QUIET_WITHIN_S = 0.5
"""Longest wait in s for the line to fall silent."""

PSEUDO_TERMINALS = "/dev/pts"
_PARITY = {"even": serial.PARITY_EVEN, "odd": serial.PARITY_ODD, "none": serial.PARITY_NONE}


@dataclass(frozen=True)
class RtuEndpoint:
    """Address of a Modbus unit on a serial line."""

    line: SerialLine
    unit: int

    def __str__(self) -> str:
        return f"modbus-rtu {self.line} unit {self.unit}"


class RtuTransport:
    """Modbus master on one serial line.

    `stray_bytes` is the number of received bytes that belonged to no request.
    """

    def __init__(self, endpoint: RtuEndpoint, clock: Clock, *, timeout_s: float, where: Mapping[str, str]) -> None:
        self._line = endpoint.line
        self._unit = endpoint.unit
        self._clock = without_interrupts(clock)
        self._timeout_s = timeout_s
        self._where = where
        self._serial: serial.Serial | None = None
        self._quiet_since_s = float("-inf")
        self._needs_clearing = False
        self.stray_bytes = 0

    @property
    def connected(self) -> bool:
        return self._serial is not None

    @property
    def has_checksum(self) -> bool:
        return True

    def open(self) -> None:
        line = self._line
        try:
            self._serial = serial.Serial(
                line.port,
                line.baud,
                parity=_parity(line),
                stopbits=line.stop_bits,
                timeout=0,
                write_timeout=self._timeout_s + line.exchange_s(256, 0),
                exclusive=True,
            )
        except (OSError, ValueError, termios.error) as error:
            raise LinkLost(
                f"the serial port cannot be opened: {cause_of(error)}",
                hint="check serial.port, that the adapter is plugged in, that this user may open it (group dialout), "
                "and that no other program has it open",
                **self._where,
            ) from error

    def close(self) -> None:
        if self._serial is not None:
            self._serial.close()
            self._serial = None

    def wire_time_s(self, request: bytes) -> float:
        return self._line.exchange_s(len(request), answer_length(request))

    def ask(self, request: bytes) -> bytes:
        port = self._serial
        if port is None:
            raise LinkLost("the serial port is not open", hint="open the device first", **self._where)
        started_s, duration_s = self._clock.now(), self.wire_time_s(request)
        try:
            self._clear_line(port)
            # Stays True if the request fails: its answer may still come.
            self._needs_clearing = True
            answer = self._transact(port, build_frame(self._unit, request), request)
            self._needs_clearing = False
        except LinkTimeout:
            # On a clock that is not the wall clock, the vain wait takes machine time as well.
            duration_s += self._timeout_s
            raise
        except serial.SerialTimeoutException as error:
            raise LinkTimeout(
                "the serial port does not accept the bytes to send", hint="check the adapter", **self._where
            ) from error
        except OSError as error:
            self.close()
            raise LinkLost(
                f"serial port lost: {cause_of(error)}", hint="check that the adapter is plugged in", **self._where
            ) from error
        finally:
            self._pass_time(started_s + duration_s)
        return answer

    def _clear_line(self, port: serial.Serial) -> None:
        """Discard bytes of earlier answers, then wait for the silence that the standard requires before a frame."""
        self.stray_bytes += len(port.read(port.in_waiting))
        if self._needs_clearing:
            self.stray_bytes += len(self._read_until_quiet(port))
        self._pass_time(self._quiet_since_s + self._line.gap_s)

    def _pass_time(self, instant_s: float) -> None:
        self._clock.sleep(instant_s - self._clock.now())
        self._quiet_since_s = self._clock.now()

    def _transact(self, port: serial.Serial, frame: bytes, request: bytes) -> bytes:
        port.write(frame)
        deadline_s = wall_seconds() + self.wire_time_s(request) + self._timeout_s
        if self._line.echo:
            self._read_echo(port, frame, deadline_s)
        answer = self._read_frame(port, frame, deadline_s)
        if answer[0] != self._unit:
            raise ProtocolError(
                f"unit {answer[0]} answered instead of unit {self._unit}",
                hint="two devices on the line have the same address, or the unit in the configuration is wrong",
                **self._where,
            )
        return answer[1:-2]

    def _read_frame(self, port: serial.Serial, sent: bytes, deadline_s: float) -> bytes:
        """Read one frame with a valid CRC. The caller must check that its length and function are the expected ones."""
        data = b""
        # The length becomes known with the third byte; until then, only the bytes that every answer has are requested.
        while (expected := _length(data, sent[1])) is None or len(data) < expected:
            more = self._read_some(port, deadline_s - wall_seconds(), (expected or ADDRESS_AND_CRC) - len(data))
            if not more:
                self._require_no_echo(data, sent)
                raise self._incomplete(data, expected)
            data += more
            if expected is None and len(data) >= ADDRESS_AND_CRC and _length(data, sent[1]) is None:
                data += self._read_until_quiet(port)
                break
        # An adapter that echoes returns the request, whose CRC is valid too.
        if has_valid_crc(data) and data != sent:
            return data
        data += self._read_until_quiet(port)
        self._require_no_echo(data, sent)
        raise DamagedFrame(
            f"garbled answer: {_hex(data)}",
            hint=f"check baud rate, parity and stop bits at both ends (here {self._line.mode}), termination and shield",
            **self._where,
        )

    def _read_echo(self, port: serial.Serial, frame: bytes, deadline_s: float) -> None:
        echo = b""
        while len(echo) < len(frame):
            more = self._read_some(port, deadline_s - wall_seconds(), len(frame) - len(echo))
            if not more:
                break
            echo += more
        if echo == frame:
            return
        if not echo:
            raise LinkTimeout(
                "neither echo nor answer", hint="set serial.echo = false if the adapter does not echo", **self._where
            )
        raise DamagedFrame(
            f"the request was echoed as {_hex(echo)}",
            hint="check for another sender on the line, or set serial.echo = false if the adapter does not echo",
            **self._where,
        )

    def _read_some(self, port: serial.Serial, within_s: float, at_most: int) -> bytes:
        """Return up to `at_most` bytes as soon as any arrive; b"" if none arrive within `within_s` of wall time."""
        ready, _, _ = select.select([port.fileno()], [], [], max(within_s, 0.0))
        return bytes(port.read(at_most)) if ready else b""

    def _read_until_quiet(self, port: serial.Serial) -> bytes:
        """Read until the line is silent, and return the bytes read."""
        data = b""
        deadline_s = wall_seconds() + QUIET_WITHIN_S
        while (more := self._read_some(port, max(QUIET_S, self._line.gap_s), 256)) and wall_seconds() < deadline_s:
            data += more
        return data

    def _incomplete(self, data: bytes, expected: int | None) -> LinkTimeout | DamagedFrame:
        if not data:
            return LinkTimeout(
                f"no answer within {self._timeout_s:g} s",
                hint=f"check unit id, cable, and baud rate, parity and stop bits ({self._line.mode}) at both ends",
                **self._where,
            )
        of = f" of {expected}" if expected is not None else ""
        return DamagedFrame(
            f"answer cut short after {len(data)}{of} bytes: {_hex(data)}",
            hint="check the cable; a controller that pauses within a frame violates the standard",
            **self._where,
        )

    def _require_no_echo(self, data: bytes, sent: bytes) -> None:
        if data.startswith(sent):
            raise ProtocolError(
                "the line echoes the request",
                hint="set serial.echo = true, or switch off the adapter's echo",
                **self._where,
            )


def _parity(line: SerialLine) -> str:
    """Return pyserial's parity setting: none on a pseudo-terminal, where the C library refuses to set parity."""
    if Path(line.port).resolve().is_relative_to(PSEUDO_TERMINALS):
        return serial.PARITY_NONE
    return _PARITY[line.parity]


def _length(data: bytes, function: int) -> int | None:
    """Return the length in bytes of the answer frame that begins with `data`; None if `data` does not determine it."""
    if len(data) < ADDRESS_AND_CRC or (data[1] & ~EXCEPTION_BIT) != function:
        return None
    # Address, function, exception code and CRC.
    if data[1] & EXCEPTION_BIT:
        return 5
    # Address, function, register, count and CRC.
    if function == WRITE:
        return 8
    # Address, function, byte count, data and CRC.
    return data[2] + 5 if function in (READ, WRITE_AND_READ) else None


def _hex(data: bytes) -> str:
    shown = data[:12].hex(" ")
    return f"{shown} … ({len(data)} bytes)" if len(data) > 12 else shown
