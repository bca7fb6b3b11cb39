"""Serial CAN adapter on a pseudo-terminal, and the bus behind it: the peer of the ``slcan`` interface.

Like the socketcand server, the adapter is itself a python-can bus: `recv` returns the frames from the host, and `send`
passes a frame to the host. It is written from the manuals of LAWICEL's CAN232 and CANUSB. Commands are ASCII text
ending with CR. The adapter answers a command with CR or, if it refuses the command, with BELL. The host closes the
channel, sets its bit rate and opens it. Frames have the forms ``tiiildd..`` and ``Tiiiiiiiildd..``. Like the CANUSB,
the adapter sends received frames without being polled.

A pseudo-terminal buffers only about 10 kB of unread data. Further frames wait in order in the adapter's queue. If the
queue overflows too, frames are lost as in the real adapter, and bit 0 of the status flags is set.
"""

from __future__ import annotations

import queue
import threading
from collections import deque

import can

from drivers.clock import wall_seconds
from simulators.wire.pty_port import ANY, PseudoTerminal

CR, BELL = b"\r", b"\a"
QUEUED_FRAMES = 8192
LONGEST_COMMAND = len("T1FFFFFFF8") + 16
FLUSH_CYCLE_S = 0.002
"""Interval in s at which writing to a full line is tried again."""
RECEIVE_QUEUE_FULL, ERROR_WARNING, ERROR_PASSIVE, BUS_ERROR = 0x01, 0x04, 0x20, 0x80
TRANSMIT = tuple("tTrR")
BIT_RATES = LENGTHS = tuple("012345678")
"""Codes S0 ... S8 mean 10, 20, 50, 100, 125, 250, 500, 800 and 1000 kbit/s."""
IDENTIFICATION = {"V": b"V1013", "N": b"NVC01"}
"""Answers with hardware and software version, and serial number."""


class SlcanPeerBus(can.BusABC):
    """CAN bus behind a simulated serial adapter. The host opens the pseudo-terminal at `port`.

    `link` is a path that is made a link to the pseudo-terminal, or "any" for no link.
    """

    def __init__(self, link: str = ANY) -> None:
        super().__init__(channel=link)
        self._lock = threading.RLock()
        self._line = PseudoTerminal("slcan adapter", self._receive, link)
        self.port = self._line.device_path
        self.channel_info = f"slcan adapter at {self.port}"
        self._pending = b""
        self._outgoing: deque[bytes] = deque()
        self._received: queue.SimpleQueue[can.Message] = queue.SimpleQueue()
        self._open = self._listening_only = self._bit_rate_set = self._timestamped = False
        self._flags = 0
        self._off_bus = False
        self._line.start()

    def go_off_bus(self) -> None:
        """Simulate the error state bus-off, as after a short circuit of the cable.

        Frames pass in neither direction, and the status flags report the error.
        """
        self._off_bus = True

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        """Send a frame to the host if the host has opened the channel of the serial adapter."""
        del timeout
        if not self._open or self._off_bus or msg.is_error_frame:
            return
        with self._lock:
            if len(self._outgoing) >= QUEUED_FRAMES:
                self._flags |= RECEIVE_QUEUE_FULL
                return
            stamp = f"{int(1e3 * wall_seconds()) % 60_000:04X}".encode("ascii") if self._timestamped else b""
            self._queue(format_frame(msg) + stamp + CR)

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        ends_s = None if timeout is None else wall_seconds() + timeout
        while True:
            full = self._flush()
            left_s = None if ends_s is None else max(0.0, ends_s - wall_seconds())
            wait_s = left_s if not full else min(FLUSH_CYCLE_S, left_s) if left_s is not None else FLUSH_CYCLE_S
            try:
                return self._received.get(timeout=wait_s), False
            except queue.Empty:
                if ends_s is not None and wall_seconds() >= ends_s:
                    return None, False

    def shutdown(self) -> None:
        if not self._is_shutdown:
            super().shutdown()
            self._line.close()

    def _queue(self, data: bytes) -> None:
        with self._lock:
            self._outgoing.append(data)
            self._flush()

    def _flush(self) -> bool:
        """Write as much as the line accepts; return True if data remains."""
        with self._lock:
            while self._outgoing and not self._is_shutdown:
                taken = self._line.offer(self._outgoing[0])
                if taken < len(self._outgoing[0]):
                    self._outgoing[0] = self._outgoing[0][taken:]
                    return True
                self._outgoing.popleft()
            return False

    def _receive(self, data: bytes) -> None:
        """Process bytes from the host."""
        with self._lock:
            *commands, self._pending = (self._pending + data).split(CR)
            if len(self._pending) > LONGEST_COMMAND:
                self._pending = b""
                self._queue(BELL)
            for command in commands:
                self._queue(self._answer(command.decode("ascii", errors="replace")))

    def _answer(self, command: str) -> bytes:
        letter, rest = command[:1], command[1:]
        if letter in TRANSMIT:
            return self._transmit(command)
        if letter == "F" and self._open:
            return f"F{self._status_flags():02X}".encode("ascii") + CR
        if letter in IDENTIFICATION:
            return IDENTIFICATION[letter] + CR
        return CR if self._set_up(letter, rest) else BELL

    def _set_up(self, letter: str, rest: str) -> bool:
        """Execute a command that opens, closes or configures the channel; return False if it is unknown or not allowed
        now.
        """
        match letter:
            case "O" | "L" if not self._open and self._bit_rate_set:
                self._outgoing.clear()
                self._open, self._listening_only = True, letter == "L"
            case "C" if self._open:
                self._open = False
            case "S" if not self._open and rest in BIT_RATES:
                self._bit_rate_set = True
            case "s" if not self._open and len(rest) == len("xxyy"):
                self._bit_rate_set = True
            case "Z" if not self._open and rest in ("0", "1"):
                self._timestamped = rest == "1"
            case _:
                return False
        return True

    def _status_flags(self) -> int:
        """Return the status flags collected since the last request."""
        flags, self._flags = self._flags, 0
        return flags | (ERROR_WARNING | ERROR_PASSIVE | BUS_ERROR if self._off_bus else 0)

    def _transmit(self, command: str) -> bytes:
        if not self._open or self._listening_only or self._off_bus:
            return BELL
        try:
            self._received.put(parse_frame(command))
        except ValueError:
            return BELL
        return (b"Z" if command[0] in "TR" else b"z") + CR


def format_frame(message: can.Message) -> bytes:
    """Return the text of a frame as the serial CAN adapter writes it, without the final CR."""
    letters = "rR" if message.is_remote_frame else "tT"
    extended = message.is_extended_id
    identifier = f"{message.arbitration_id:08X}" if extended else f"{message.arbitration_id:03X}"
    data = "" if message.is_remote_frame else bytes(message.data).hex().upper()
    return f"{letters[extended]}{identifier}{message.dlc}{data}".encode("ascii")


def parse_frame(command: str) -> can.Message:
    """Return the frame that a transmit command for the serial CAN adapter contains. Raises ValueError for an invalid
    command.
    """
    extended, remote = command[0] in "TR", command[0] in "rR"
    digits = 8 if extended else 3
    identifier, length, data = command[1 : 1 + digits], command[1 + digits : 2 + digits], command[2 + digits :]
    if len(identifier) != digits or length not in LENGTHS:
        raise ValueError(f"{command!r} is not a frame")
    if len(data) != (0 if remote else 2 * int(length)):
        raise ValueError(f"the data of {command!r} does not have the announced length")
    return can.Message(
        arbitration_id=int(identifier, 16),
        is_extended_id=extended,
        is_remote_frame=remote,
        dlc=int(length),
        data=None if remote else bytes.fromhex(data),
        check=True,
    )
