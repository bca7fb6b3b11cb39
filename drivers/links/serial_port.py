"""A serial line in lines of text, the only module here that opens a port with pyserial for a line protocol.

Bytes are waited for with `select` and not with pyserial's timeout: changing that one reconfigures the port.
"""

from __future__ import annotations

import select
import termios
from dataclasses import dataclass
from typing import Literal

import serial

from drivers.clock import wall_seconds
from drivers.errors import LinkLost

LONGEST_LINE = 4096
"""Bytes without an end of line after which the peer is taken for something else."""
WRITE_WITHIN_S = 2.0


@dataclass(frozen=True)
class SerialAddress:
    """Where a serial device is, and how its bytes are framed: eight bits, no parity."""

    port: str
    baud: int
    stop_bits: Literal[1, 2] = 1

    def __str__(self) -> str:
        return f"serial {self.port} {self.baud} 8N{self.stop_bits}"


class SerialPort:
    """Bytes out, bytes or lines in. Every wait is bounded in wall time. Raises LinkLost when the port is gone."""

    def __init__(self, address: SerialAddress, *, device: str = "") -> None:
        self.where: dict[str, str] = {"device": device} if device else {}
        self.where["link"] = str(address)
        self._address = address
        self._port: serial.Serial | None = None
        self._received = b""

    @property
    def connected(self) -> bool:
        return self._port is not None

    def open(self) -> None:
        """Alone: a second program on one line reads half of the answers."""
        self.close()
        address = self._address
        try:
            self._port = serial.Serial(
                address.port,
                address.baud,
                stopbits=address.stop_bits,
                timeout=0,
                write_timeout=WRITE_WITHIN_S,
                exclusive=True,
            )
        except (OSError, ValueError, termios.error) as error:
            raise LinkLost(
                f"the serial port cannot be opened: {error}",
                hint="check the name, that no other program has it, and that this user may (group dialout)",
                **self.where,
            ) from error
        self._received = b""
        self._keep_dtr_on_close()

    def close(self) -> None:
        port, self._port = self._port, None
        if port is not None:
            try:
                port.close()
            except (OSError, termios.error) as error:
                raise self._lost(error) from error

    def write(self, data: bytes) -> None:
        try:
            self._require_port().write(data)
        except (OSError, termios.error) as error:
            raise self._lost(error) from error

    def read(self, within_s: float) -> bytes:
        """What has come, at least one byte, or nothing within that wall time."""
        port = self._require_port()
        try:
            ready, _, _ = select.select([port.fileno()], [], [], max(within_s, 0.0))
            if not ready:
                return b""
            data: bytes = port.read(max(port.in_waiting, 1))
        except (OSError, termios.error) as error:
            raise self._lost(error) from error
        return data

    def read_line(self, within_s: float) -> bytes | None:
        """The next line that is not empty, without its end; None if none is complete within that wall time."""
        deadline_s = wall_seconds() + within_s
        while True:
            end = self._received.find(b"\n")
            if end >= 0:
                line, self._received = self._received[:end].strip(b"\r\n\0"), self._received[end + 1 :]
                if line:
                    return line
                continue
            if len(self._received) > LONGEST_LINE:
                line, self._received = self._received, b""
                return line
            data = self.read(deadline_s - wall_seconds())
            if not data:
                return None
            self._received += data

    def _keep_dtr_on_close(self) -> None:
        """Closing must not drop DTR: many boards restart, and forget where they are, when it comes up again."""
        try:
            attributes = termios.tcgetattr(self._require_port().fileno())
            attributes[2] &= ~termios.HUPCL
            termios.tcsetattr(self._require_port().fileno(), termios.TCSANOW, attributes)
        except (OSError, termios.error) as error:
            raise self._lost(error) from error

    def _require_port(self) -> serial.Serial:
        if self._port is None:
            raise LinkLost("the serial port is not open", hint="open the device first", **self.where)
        return self._port

    def _lost(self, error: Exception) -> LinkLost:
        self._port = None
        return LinkLost(
            f"the serial port is gone: {error}", hint="check the cable and that the controller is on", **self.where
        )
