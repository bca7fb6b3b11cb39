"""Interface of the transports that carry a Modbus request to a unit and return the answer."""

from __future__ import annotations

from typing import Protocol

from drivers.errors import ProtocolError

READ, WRITE, WRITE_AND_READ = 3, 16, 23
EXCEPTION_BIT = 0x80


class DamagedFrame(ProtocolError):
    """Error for an answer of a Modbus unit that was truncated or garbled on the line.

    The unit itself works, so a repeated request may succeed.
    """


class Transport(Protocol):
    """Connection to one Modbus unit.

    An error that a transport raises names the device and the link; the `ModbusLink` that uses the transport adds the
    register.
    """

    @property
    def connected(self) -> bool: ...

    @property
    def has_checksum(self) -> bool:
        """True if each frame has a checksum, so that a frame which arrives is the one that was sent."""
        ...

    def open(self) -> None:
        """Open the connection. Raises `LinkLost` if this fails."""
        ...

    def close(self) -> None: ...

    def ask(self, request: bytes) -> bytes:
        """Send `request` and return the answer; both begin with the function code and contain no checksum.

        An exception response of the unit is returned as an answer. Raises `LinkLost`, `LinkTimeout`, `DamagedFrame` or
        `ProtocolError` if there is no valid answer.
        """
        ...

    def wire_time_s(self, request: bytes) -> float:
        """Return the shortest transmission time in s of `request` and its answer; 0 if the time is unknown."""
        ...


def answer_length(request: bytes) -> int:
    """Return the length in bytes of the answer to `request` if the unit reports no exception.

    The length is counted from the function code on, without a checksum. `request` also begins with the function code
    and contains no checksum. Source: MODBUS Application Protocol V1.1b3, 6.3 … 6.17.
    """
    # Function code, byte count, and two bytes for each register. Both requests have the count of registers to be read
    # in the same place. The answer to a write repeats address and count: 1 + 2 + 2 bytes.
    if request[0] in (READ, WRITE_AND_READ):
        return 2 + 2 * int.from_bytes(request[3:5], "big")
    return 5
