"""Interface of a transport that carries Modbus requests to a unit and its answers back."""

from __future__ import annotations

from typing import Protocol

from drivers.errors import ProtocolError

READ, WRITE, WRITE_AND_READ = 3, 16, 23
EXCEPTION_BIT = 0x80


class DamagedFrame(ProtocolError):
    """An answer was truncated or garbled on the line. The peer itself is healthy, so a retry may succeed."""


class Transport(Protocol):
    """Connection to one unit. Errors name the device and the link; the caller adds the register."""

    @property
    def connected(self) -> bool: ...

    def open(self) -> None:
        """Connect. Raises `LinkLost`."""
        ...

    def close(self) -> None: ...

    def ask(self, request: bytes) -> bytes:
        """Send `request` and return its answer; both begin with the function code and have no checksum.

        An exception response counts as an answer. Raises `LinkLost`, `LinkTimeout`, `DamagedFrame`, `ProtocolError`.
        """
        ...

    def wire_time_s(self, request: bytes) -> float:
        """Return the shortest transmission time in s of `request` and its answer; 0 if unknown."""
        ...


def answer_length(request: bytes) -> int:
    """Return the length in bytes of a normal answer to `request`, both counted from the function code on.

    Source: MODBUS Application Protocol V1.1b3, 6.3 … 6.17.
    """
    if request[0] in (READ, WRITE_AND_READ):
        return 2 + 2 * int.from_bytes(request[3:5], "big")
    return 5
