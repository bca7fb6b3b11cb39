"""Serial cable in virtual time between the driver `serial-cnc` and a simulated controller.

Bytes take the time of their baud rate and of a USB adapter. The cable can be unplugged, stall, delay, garble and lose
data. The program runs in one thread, so that a copy of it can be forked at any instant.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable

from drivers.clock import VirtualClock
from drivers.errors import LinkLost, LinkTimeout
from drivers.links.serial_port import URGENT_WITHIN_S, WRITE_WITHIN_S

BAUD = 115200
BITS_PER_CHARACTER = 10
ADAPTER_S = 0.001
LOOK_S = 0.01
"""Longest step of the clock in s while the driver waits for a line."""
HINT = "check the cable"


class VirtualCable:
    """Line of the driver (`drivers.links.serial_port.LineLink`), whose waits advance the virtual clock.

    `received` is the function of the controller that accepts bytes; `hear` accepts the bytes that the controller sends.
    """

    def __init__(self, clock: VirtualClock) -> None:
        self.where = {"device": "cnc", "link": "virtual cable"}
        self.received: Callable[[bytes], None] = lambda _: None
        self.connected = False
        self.unplugged = False
        self.stalled_until_s = 0.0
        self.late_s = 0.0
        self.change_line: Callable[[bytes], bytes] = lambda line: line
        self.lose_byte = False
        self.sent: list[tuple[float, bytes]] = []
        """Instants and data of everything that was written and not discarded."""
        self.refused_urgent: list[float] = []
        """Instants at which urgent data could not be sent because the cable was unplugged."""
        self._clock = clock
        self._to_controller: deque[tuple[float, int]] = deque()
        self._to_driver: deque[tuple[float, bytes]] = deque()
        self._received = b""

    # ------------------------------------------------------------------ the driver's end

    def seconds(self) -> float:
        return self._clock.now()

    def open(self, *, shared: bool = False) -> None:
        """Plug in; no other program uses a virtual cable, so `shared` changes nothing."""
        if self.unplugged:
            self.refused_urgent.append(self.seconds())
            raise LinkLost("the serial port cannot be opened: no such device", hint=HINT, **self.where)
        self.connected, self._received = True, b""

    def close(self) -> None:
        self.connected = False

    def write(self, data: bytes) -> None:
        self._require_plugged()
        if self.stalled_until_s > self.seconds():
            self._advance(WRITE_WITHIN_S)
            raise LinkTimeout("the serial port accepts no data", hint=HINT, **self.where)
        self._send(data)

    def write_urgent(self, data: bytes) -> None:
        self._require_plugged()
        if self.stalled_until_s > self.seconds():
            self._advance(URGENT_WITHIN_S)
            self._to_controller.clear()
        self._send(data)

    def read_line(self, within_s: float) -> bytes | None:
        deadline_s = self.seconds() + within_s
        while True:
            self._take_due()
            line = self._next_line()
            if line:
                return line
            self._require_plugged()
            if self.seconds() >= deadline_s:
                return None
            self._clock.advance_to(min(deadline_s, self.seconds() + LOOK_S, *(due for due, _ in self._to_driver)))

    def _next_line(self) -> bytes:
        while b"\n" in self._received:
            line, _, self._received = self._received.partition(b"\n")
            if line.strip(b"\r\n\0"):
                return line.strip(b"\r\n\0")
        return b""

    def _take_due(self) -> None:
        while self._to_driver and self._to_driver[0][0] <= self.seconds():
            self._received += self._to_driver.popleft()[1]

    def _advance(self, duration_s: float) -> None:
        self._clock.advance_to(self.seconds() + duration_s)

    def _require_plugged(self) -> None:
        if not self.connected or self.unplugged:
            self.connected = False
            raise LinkLost("the serial port is gone", hint=HINT, **self.where)

    def _send(self, data: bytes) -> None:
        self.sent.append((self.seconds(), data))
        at_s = max(self.seconds(), self.stalled_until_s, *(due for due, _ in list(self._to_controller)[-1:]))
        at_s += ADAPTER_S if not self._to_controller else 0.0
        for byte in data:
            at_s += BITS_PER_CHARACTER / BAUD
            self._to_controller.append((at_s, byte))

    # ------------------------------------------------------------------ the controller's end

    def next_arrival_s(self) -> float | None:
        """Return the instant in s at which the next byte reaches the controller."""
        return self._to_controller[0][0] if self._to_controller else None

    def deliver(self, now_s: float) -> None:
        """Hand the bytes that have arrived by `now_s` to the controller."""
        due = bytearray()
        while self._to_controller and self._to_controller[0][0] <= now_s:
            due.append(self._to_controller.popleft()[1])
        if due and self.lose_byte:
            self.lose_byte = False
            del due[0]
        if due and not self.unplugged:
            self.received(bytes(due))

    def hear(self, data: bytes) -> None:
        if self.unplugged:
            return
        last_s = self._to_driver[-1][0] if self._to_driver else 0.0
        at_s = max(self.seconds() + ADAPTER_S + self.late_s, last_s) + BITS_PER_CHARACTER * len(data) / BAUD
        self._to_driver.append((at_s, self.change_line(data)))

    def pull(self) -> None:
        """Unplug the cable. What is on its way is lost."""
        self.unplugged = True
        self._to_controller.clear()
        self._to_driver.clear()
