"""Simulated machine controller (CNC) that sends (punches) and receives (reads) its parameters in paper tape format over
a serial line, written from the manufacturer's manuals.

The controller reads characters into a small buffer, at the speed of its serial line. To the sending computer it sends
the control character DC3 (stop) when the buffer is nearly full, and DC1 (continue) when the buffer is nearly empty.
Characters are transferred as machine time passes. The methods `press_read` and `press_punch` correspond to keys that
the operator presses.

Sources: FANUC B-63503EN/02 (Series 0i connection manual), section 5.3: DC1 starts and DC3 stops a reader, DC2 switches
a punch on and DC4 switches it off, and each character of eight bits contains one even parity bit. FANUC B-63950EN/02,
chapter 3: each parameter is written as ``N ... P ...;``.
"""

from __future__ import annotations

import re
from collections import deque
from enum import Enum
from typing import Final

from simulators.wire.pty_port import PseudoTerminal

DC1, DC2, DC3, DC4 = 0x11, 0x12, 0x93, 0x14
"""Control characters with their parity holes: DC3 has three ones in seven bits, so its eighth is set."""
LINE_FEED: Final = 0x0A
PERCENT: Final = 0xA5
BITS: Final = 11
_PARAMETER: Final = re.compile(r"N(\d+)(?:Q\d)?((?:[AS]\d+)?[PMI][+-]?[\d.]+(?:[AS]\d+[PMI][+-]?[\d.]+)*)")


class Mode(Enum):
    READY = "ready"
    READING = "reading"
    PUNCHING = "punching"
    ALARM = "alarm"


def with_parity(character: str) -> int:
    code = ord(character)
    return code | 0x80 if bin(code).count("1") % 2 else code


class TapeCnc:
    """Simulated CNC that sends and receives its parameters in paper tape format over a serial line.

    `parameters` maps each parameter number to the text that follows the number on the tape, for example ``P00001100``
    or ``A1P10A2P20``.
    """

    def __init__(
        self, parameters: dict[int, str], *, baud: int = 4800, memory: int = 128, writable: bool = True
    ) -> None:
        self.parameters = dict(parameters)
        self.line = PseudoTerminal("tape", self._received)
        self.mode = Mode.READY
        self.alarm = ""
        self.overrun = 0
        self.stays_stopped = False
        self.misstored: dict[int, str] = {}
        """Parameters that the controller stores with a different value than it received, as if its ladder program
        protected them.
        """
        self._writable = writable
        self._per_s = baud / BITS
        self._memory = memory
        self._now_s = 0.0
        self._waiting: deque[int] = deque()
        self._outgoing: deque[int] = deque()
        self._stopped_at: int | None = None
        self._punch_held = False
        self._received_count = 0
        self._block = ""
        self._percent_count = 0
        self._share = 0.0

    def press_read(self) -> None:
        self.mode, self._block, self._percent_count, self._received_count = Mode.READING, "", 0, 0
        self._waiting.clear()
        self._stopped_at = None
        self._send(DC1)

    def press_punch(self, leader: str = "") -> None:
        """Start to send (punch) all parameters. `leader` is human-readable text that is sent before the parameters."""
        self.mode = Mode.PUNCHING
        blocks = [f"N{number:05d}Q1{values}" for number, values in sorted(self.parameters.items())]
        text = leader + "%\n" + "\n".join(blocks) + "\n%\n"
        self._outgoing = deque([DC2, 0, 0, *(with_parity(character) for character in text), DC4])

    def press_reset(self) -> None:
        """Interrupt any sending (punching) or receiving (reading) of parameters."""
        self.mode = Mode.READY
        self._outgoing.clear()

    def on_advance(self, now_s: float) -> None:
        """Transfer as many characters as the serial line carries between the last call and machine time `now_s`."""
        self.line.pump()
        self._share += (now_s - self._now_s) * self._per_s
        self._now_s = now_s
        while self._share >= 1.0:
            self._share -= 1.0
            self._take_one()
            self._punch_one()

    # ------------------------------------------------------------------ reading

    def _received(self, data: bytes) -> None:
        for byte in data:
            if byte in (DC1, DC3) and self.mode is Mode.PUNCHING:
                self._punch_held = byte == DC3
            elif self.mode is Mode.READING:
                self._store(byte)

    def _store(self, byte: int) -> None:
        self._received_count += 1
        if self._stopped_at is not None:
            self.overrun = max(self.overrun, self._received_count - self._stopped_at)
        self._waiting.append(byte)
        if self._stopped_at is None and len(self._waiting) > self._memory // 2:
            self._stopped_at = self._received_count
            self._send(DC3)

    def _take_one(self) -> None:
        if self.mode is not Mode.READING or not self._waiting:
            return
        self._character(self._waiting.popleft())
        empty = len(self._waiting) < self._memory // 8
        if self._stopped_at is not None and empty and not self.stays_stopped and self.mode is Mode.READING:
            self._stopped_at = None
            self._send(DC1)

    def _character(self, byte: int) -> None:
        if bin(byte).count("1") % 2:
            self._fail("parity")
        elif byte == PERCENT:
            self._percent_count += 1
            if self._percent_count == 2:
                self.mode = Mode.READY
                self._send(DC3)
        elif byte == LINE_FEED:
            self._end_block()
        elif self._percent_count == 1:
            self._block += chr(byte & 0x7F)

    def _end_block(self) -> None:
        block, self._block = self._block, ""
        if not block:
            return
        match = _PARAMETER.fullmatch(block)
        if match is None:
            self._fail(f"format of {block}")
        elif not self._writable:
            self._fail("parameters are write-protected")
        else:
            number = int(match[1])
            self.parameters[number] = self.misstored.get(number, match[2])

    def _fail(self, text: str) -> None:
        """Stop the reader and wait for the operator."""
        self.mode, self.alarm = Mode.ALARM, text
        self._send(DC3)

    # ------------------------------------------------------------------ punching

    def _punch_one(self) -> None:
        if self._punch_held or not self._outgoing:
            return
        self._send(self._outgoing.popleft())
        if not self._outgoing:
            self.mode = Mode.READY

    def _send(self, byte: int) -> None:
        self.line.send(bytes((byte,)))
