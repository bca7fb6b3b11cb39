"""What carries a Modbus request to a unit and its answer back, whatever the wire."""

from __future__ import annotations

from typing import Protocol

from drivers.errors import ProtocolError

READ, WRITE, WRITE_AND_READ = 3, 16, 23
EXCEPTION_BIT = 0x80


class DamagedFrame(ProtocolError):
    """What came over the line was cut short or garbled. Nothing is wrong with the peer: asking again may help."""


class Transport(Protocol):
    """One connection to one unit. Errors name the device and the link; the register is added by who asked."""

    @property
    def connected(self) -> bool: ...

    def open(self) -> None:
        """Raises `LinkLost`."""
        ...

    def close(self) -> None: ...

    def ask(self, request: bytes) -> bytes:
        """The answer to `request`, both from the function code on. Raises `LinkLost`, `LinkTimeout`,
        `DamagedFrame`, `ProtocolError`; an exception response is an answer."""
        ...

    def wire_time_s(self, request: bytes) -> float:
        """The least time that the wire itself takes for `request` and its answer; 0 where it is not known."""
        ...


def answer_length(request: bytes) -> int:
    """Bytes of a good answer to `request`, both from the function code on (Application Protocol V1.1b3, 6.3 … 6.17)."""
    if request[0] in (READ, WRITE_AND_READ):
        return 2 + 2 * int.from_bytes(request[3:5], "big")
    return 5
