"""Simulated controller as a Modbus RTU unit on a pseudo-terminal.

A pseudo-terminal has no transmission time and no baud rate, so this module simulates both. In lockstep, the agent
controls time: it advances the machine's clock by the transmission time, and an answer is sent at once. With any other
clock, the request, the silence before the answer and the answer take as long as on a cable. A client that has set
another baud rate gets no answer.
"""

from __future__ import annotations

import os
import termios
from dataclasses import dataclass
from typing import Any, Final

import structlog

from drivers.clock import Clock, wall_seconds
from simulators.wire.modbus.controller import UNIT, WorldWithController, attach_registers
from simulators.wire.modbus.frames import answer_request
from simulators.wire.modbus.numbers import RegisterNumberFormat
from simulators.wire.modbus.rtu_frames import InvalidFrameError, answer_frame, take_request
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
