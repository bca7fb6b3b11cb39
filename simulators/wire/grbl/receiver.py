"""Receive buffer of a simulated GRBL, and the filter that makes lines from its bytes.

Source: gnea/grbl, grbl/serial.c and protocol.c.
"""

from __future__ import annotations

from simulators.wire.grbl.dialect import GrblDialect


class LineReceiver:
    """Receive buffer from which the main program takes one line at a time, without blanks and comments."""

    def __init__(self, dialect: GrblDialect) -> None:
        self._capacity = dialect.receive_buffer - 1  # one byte is never used
        self._longest = dialect.line_buffer - 1
        self._waiting = bytearray()
        self._reading: list[str] = []
        self._comment = ""
        self._complete = False

    def clear(self) -> None:
        self._waiting.clear()
        self._begin_line()

    @property
    def waiting(self) -> int:
        """Number of bytes in the buffer that the main program has not yet taken."""
        return len(self._waiting)

    def store(self, byte: int) -> None:
        """Store one byte. A byte that does not fit is lost, as are bytes beyond ASCII."""
        if byte < 0x80 and len(self._waiting) < self._capacity:
            self._waiting.append(byte)

    def line_received(self) -> bool:
        """Take bytes up to the end of a line, and return True if the line is complete."""
        while self._waiting and not self._complete:
            character = chr(self._waiting.pop(0))
            if character in "\r\n":
                self._complete = True
            elif self._comment:
                self._comment = "" if (self._comment, character) == ("(", ")") else self._comment
            elif character in "(;":
                self._comment = character
            elif character > " " and character != "/":
                self._reading.append(character.upper())
        return self._complete

    def take_line(self) -> str | None:
        """Return the complete line, or None if it is longer than the line buffer."""
        line = "".join(self._reading)
        self._begin_line()
        return line if len(line) <= self._longest else None

    def _begin_line(self) -> None:
        self._reading.clear()
        self._comment, self._complete = "", False
