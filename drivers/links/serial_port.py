"""Serial port for line-oriented text protocols, over pyserial.

Waits use `select` instead of the timeout of pyserial, because changing the timeout of pyserial reconfigures the port.
"""

from __future__ import annotations

import contextlib
import fcntl
import os
import select
import termios
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal, Protocol

import serial

from drivers.clock import wall_seconds
from drivers.errors import LinkLost, LinkTimeout
from drivers.foreign_errors import cause_of

LONGEST_LINE = 4096
"""Largest length of a line in bytes; a peer that sends more without an end of line is not a line-oriented device."""
WRITE_WITHIN_S = 2.0
URGENT_WITHIN_S = 0.1
"""Wall time in s for which urgent data may wait for unsent data before the unsent data are discarded."""


@dataclass(frozen=True)
class SerialAddress:
    """Port, baud rate and stop bits of a serial device; frames have eight data bits and no parity bit."""

    port: str
    baud: int
    stop_bits: Literal[1, 2] = 1

    def __str__(self) -> str:
        return f"serial {self.port} {self.baud} 8N{self.stop_bits}"


class LineLink(Protocol):
    """Link to a device with a line-oriented text protocol. `SerialPort` implements it.

    The methods raise LinkLost if the link no longer exists, and LinkTimeout if it accepts no data.
    """

    @property
    def where(self) -> Mapping[str, str]: ...

    @property
    def connected(self) -> bool: ...

    def seconds(self) -> float:
        """Return the time in s, since an arbitrary start, in which waits for the device are limited."""
        ...

    def open(self, *, shared: bool = False) -> None:
        """Open the link for exclusive use; with `shared`, also while another program uses it."""
        ...

    def close(self) -> None: ...

    def write(self, data: bytes) -> None: ...

    def write_urgent(self, data: bytes) -> None:
        """Send `data` at once; if the link accepts no data, discard what has not been sent yet."""
        ...

    def read_line(self, within_s: float) -> bytes | None: ...


class SerialPort:
    """Serial port that sends bytes and receives bytes or lines.

    Every wait has a time limit in wall time. The methods raise LinkLost if the port no longer exists or is not open,
    and LinkTimeout if it accepts no data.
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

    def seconds(self) -> float:
        return wall_seconds()

    def open(self, *, shared: bool = False) -> None:
        """Open the port for exclusive use.

        Otherwise, a second program on the same port would receive some of the answers of the device. With `shared` the
        port is opened even while another program holds its lock: a stop must get through, with or without answers.
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
                exclusive=None if shared else True,
            )
            if shared:
                with contextlib.suppress(BlockingIOError):
                    fcntl.flock(self._port.fileno(), fcntl.LOCK_EX | fcntl.LOCK_NB)
        except (OSError, ValueError, termios.error) as error:
            raise LinkLost(
                f"the serial port cannot be opened: {cause_of(error)}",
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
        """Send `data`. After a LinkTimeout the port stays open, and part of the data may have been sent."""
        try:
            self._require_port().write(data)
        except serial.SerialTimeoutException as error:
            raise self._stalled(WRITE_WITHIN_S) from error
        except (OSError, termios.error) as error:
            raise self._lost(error) from error

    def write_urgent(self, data: bytes) -> None:
        """Send `data` within two times `URGENT_WITHIN_S`.

        If earlier data still fill the port's buffer, they are discarded: the end of a line may then be missing.
        """
        descriptor = self._require_port().fileno()
        try:
            for last in (False, True):
                if select.select([], [descriptor], [], URGENT_WITHIN_S)[1] and os.write(descriptor, data) == len(data):
                    return
                if not last:
                    termios.tcflush(descriptor, termios.TCOFLUSH)
        except (OSError, termios.error) as error:
            raise self._lost(error) from error
        raise self._stalled(2.0 * URGENT_WITHIN_S)

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

    def _stalled(self, within_s: float) -> LinkTimeout:
        return LinkTimeout(
            f"the serial port accepts no data within {within_s:g} s",
            hint="check the cable and that the controller is on and not hanging",
            **self.where,
        )

    def _lost(self, error: Exception) -> LinkLost:
        """Close the port and return the error to be raised.

        A port that is only forgotten keeps its exclusive lock, so nobody could open it again. Unsent data are
        discarded first, since closing would wait for them.
        """
        port, self._port = self._port, None
        if port is not None:
            with contextlib.suppress(OSError, termios.error, TypeError):
                termios.tcflush(port.fileno(), termios.TCOFLUSH)
            with contextlib.suppress(OSError, termios.error):
                port.close()
        return LinkLost(
            f"the serial port is gone: {cause_of(error)}",
            hint="check the cable and that the controller is on",
            **self.where,
        )
