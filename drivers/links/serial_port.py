"""Serial port for line-oriented text protocols, over pyserial.

Waits use `select` instead of the timeout of pyserial, because changing the timeout of pyserial reconfigures the port.
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
"""Largest length of a line in bytes; a peer that sends more without an end of line is not a line-oriented device."""
WRITE_WITHIN_S = 2.0


@dataclass(frozen=True)
class SerialAddress:
    """Port, baud rate and stop bits of a serial device; frames have eight data bits and no parity bit."""

    port: str
    baud: int
    stop_bits: Literal[1, 2] = 1

    def __str__(self) -> str:
        return f"serial {self.port} {self.baud} 8N{self.stop_bits}"


class SerialPort:
    """Serial port that sends bytes and receives bytes or lines.

    Every wait has a time limit in wall time. The methods raise LinkLost if the port no longer exists or is not open.
    """

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
        """Open the port for exclusive use.

        Otherwise, a second program on the same port would receive some of the answers of the device.
        """
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
                hint="check its name, that this user may open it (group dialout) and that no other program uses it",
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
        """Return the received bytes as soon as there are any; b"" if none arrive within `within_s` of wall time."""
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
        """Return the next non-empty line without its line end.

        Return None if no line is complete within `within_s` of wall time.
        """
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
        """Keep DTR set when the port closes: many boards restart and lose their position when DTR is set again."""
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
