"""Simulated controller as a Modbus RTU unit on a pseudo-terminal.

A pseudo-terminal has no transmission time and no baud rate, so this module simulates both. In lockstep, the agent
controls time: it advances the machine's clock by the transmission time, and an answer is sent at once. With any other
clock, the request, the silence before the answer and the answer take as long as on a cable. A client that has set
a different baud rate gets no answer.

The module also finds the end of a request among the received bytes, and checks its validity. Source: MODBUS over Serial
Line Specification V1.02, 2.5.1.1 and 6.2.2. The CRC is computed bit by bit as in 6.2.2.
"""

from __future__ import annotations

import os
import termios
from dataclasses import dataclass
from typing import Any, Final

import structlog

from drivers.clock import Clock, wall_seconds
from simulators.wire.modbus.controller import UNIT, WorldWithController, attach_registers
from simulators.wire.modbus.frames import READ, WRITE, WRITE_AND_READ, answer_request
from simulators.wire.modbus.numbers import RegisterNumberFormat
from simulators.wire.pty_port import ANY, PseudoTerminal
from simulators.wire.shared_world import SharedWorld

FAST_BAUD: Final = 19200
FAST_GAP_S: Final = 0.00175
CHUNK_CHARACTERS: Final = 16
"""Characters sent at once on a paced line: the buffer depth of a common UART."""
STALE_AFTER_S: Final = 0.1
"""Wall time in s after which an incomplete request is discarded.

The standard's 1.5 characters are shorter than the delay that a scheduler may insert between two halves of one write.
"""
log = structlog.get_logger()
CRC_BYTES: Final = 2
SHORTEST: Final = 4
LONGEST: Final = 256
_BYTE_COUNT_AT: Final = {WRITE: 6, WRITE_AND_READ: 10}


@dataclass(frozen=True)
class LineSettings:
    """Parameters of the simulated serial line. Parity and stop bits affect only the timing.

    `link` is a path that is made a link to the pseudo-terminal, or "any" for no link.
    """

    link: str = ANY
    baud: int = 19200
    parity: str = "even"
    stop_bits: int = 1

    @property
    def character_s(self) -> float:
        return (1 + 8 + (0 if self.parity == "none" else 1) + self.stop_bits) / self.baud

    @property
    def gap_s(self) -> float:
        return 3.5 * self.character_s if self.baud <= FAST_BAUD else FAST_GAP_S


class ModbusRtuController:
    """Modbus RTU server of the simulated controller, which is unit 1 on the serial line.

    `clock` determines the duration of each transmission. It is None in lockstep, when the agent controls time.
    """

    def __init__(
        self,
        shared: SharedWorld[WorldWithController],
        settings: LineSettings,
        numbers: RegisterNumberFormat | None = None,
        clock: Clock | None = None,
    ) -> None:
        self._shared = shared
        self._settings = settings
        self._clock = clock
        self.registers = attach_registers(shared, numbers)
        self.terminal = PseudoTerminal("modbus rtu", self._received, settings.link)
        self._speed = getattr(termios, f"B{settings.baud}", None)
        self._line = os.open(self.terminal.port, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
        self._buffer = bytearray()
        self._heard_s = 0.0
        self.start = self.terminal.start

    def close(self) -> None:
        if self._line >= 0:
            os.close(self._line)
            self._line = -1
        self.terminal.close()

    @property
    def agent_settings(self) -> dict[str, Any]:
        """Options with which the agent's driver reaches this controller."""
        settings = self._settings
        line = {"baud": settings.baud, "parity": settings.parity, "stop_bits": settings.stop_bits}
        return {"serial": {"port": self.terminal.device_path, **line}}

    def _received(self, data: bytes) -> None:
        if self._client_speed() != self._speed:
            log.warning("request at another baud rate ignored", expected=self._settings.baud)
            self._buffer.clear()
            return
        now_s = wall_seconds()
        if now_s - self._heard_s > STALE_AFTER_S:
            self._buffer.clear()
        self._heard_s = now_s
        self._buffer += data
        try:
            while (request := take_request(self._buffer)) is not None:
                self._answer(*request)
        except InvalidFrameError as error:
            log.warning("invalid request", received=str(error))

    def _answer(self, unit: int, request: bytes) -> None:
        if unit != UNIT:
            log.warning("request for another unit ignored", unit=unit)
            return
        self._pass_characters(len(request) + 3, gap=True)
        with self._shared.lock:
            answer = answer_request(request, self.registers)
        frame = answer_frame(unit, answer)
        if self._clock is None:
            self.terminal.send(frame)
            return
        for start in range(0, len(frame), CHUNK_CHARACTERS):
            piece = frame[start : start + CHUNK_CHARACTERS]
            self._pass_characters(len(piece))
            self.terminal.send(piece)

    def _pass_characters(self, count: int, *, gap: bool = False) -> None:
        if self._clock is not None:
            self._clock.sleep(count * self._settings.character_s + gap * self._settings.gap_s)

    def _client_speed(self) -> int | None:
        speed: int = termios.tcgetattr(self._line)[5]
        return speed


class InvalidFrameError(Exception):
    """Error for received data that is not a valid request. A controller does not answer such data."""


def frame_crc(data: bytes) -> bytes:
    """Return the CRC-16 of a Modbus RTU frame as two bytes, low byte first."""
    register = 0xFFFF
    for byte in data:
        register = (register >> 8) ^ _CRC_OF_BYTE[(register ^ byte) & 0xFF]
    return register.to_bytes(CRC_BYTES, "little")


def _shifted_out(register: int) -> int:
    """Return the register after one byte was shifted out of it, with the polynomial 0xA001."""
    for _ in range(8):
        register = (register >> 1) ^ (0xA001 if register & 1 else 0)
    return register


_CRC_OF_BYTE = tuple(map(_shifted_out, range(256)))


def take_request(buffer: bytearray) -> tuple[int, bytes] | None:
    """Remove the request at the front of `buffer`, and return its unit address and the bytes between unit address and
    CRC.

    Returns None if the request is incomplete. If the bytes cannot become a valid request, the buffer is emptied and
    InvalidFrameError is raised.
    """
    length = _length(buffer)
    if length is None or len(buffer) < length:
        return None
    frame = bytes(buffer[:length])
    if length > LONGEST or frame_crc(frame[:-CRC_BYTES]) != frame[-CRC_BYTES:]:
        garbage = bytes(buffer)
        buffer.clear()
        raise InvalidFrameError(garbage.hex(" "))
    del buffer[:length]
    return frame[0], frame[1:-CRC_BYTES]


def answer_frame(unit: int, answer: bytes) -> bytes:
    frame = bytes((unit,)) + answer
    return frame + frame_crc(frame)


def _length(buffer: bytearray) -> int | None:
    """Return the length of the frame, or None if not yet known.

    For an unknown function, all bytes received so far count.
    """
    if len(buffer) < SHORTEST:
        return None
    function = buffer[1]
    if function == READ:
        return 8
    at = _BYTE_COUNT_AT.get(function)
    if at is None:
        return len(buffer)
    return at + 1 + buffer[at] + CRC_BYTES if len(buffer) > at else None
