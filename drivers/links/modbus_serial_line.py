"""Serial line for Modbus RTU: settings, timing and frames.

Source: MODBUS over Serial Line V1.02, 2.5.1 (frames, CRC-16, t1.5 and t3.5).
"""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from drivers.options import DriverOptions

FAST_BAUD = 19200
FAST_GAP_S = 0.00175
"""Gap between frames above 19200 baud, where the standard recommends a fixed time of 1.75 ms."""

ADDRESS_AND_CRC = 3
SHORTEST_FRAME = 4


class SerialLine(DriverOptions):
    """Port and format of a serial line. The defaults are those of the standard (19200 baud, 8E1)."""

    port: str = Field(min_length=1, description="device file, for example /dev/ttyUSB0 or /dev/serial/by-id/…")
    baud: int = Field(default=19200, ge=1200, le=921600)
    parity: Literal["even", "odd", "none"] = "even"
    stop_bits: Annotated[int, Field(ge=1, le=2)] = 1
    frame_gap_s: float | None = Field(
        default=None,
        gt=0.0,
        le=0.1,
        description="silence before each request; None: 3.5 characters, or 1.75 ms above 19200 baud",
    )
    echo: bool = Field(default=False, description="the adapter echoes what it sends (two-wire RS-485)")

    def __str__(self) -> str:
        return f"{self.port} {self.mode}"

    @property
    def mode(self) -> str:
        return f"{self.baud} baud 8{self.parity[0].upper()}{self.stop_bits}"

    @property
    def character_s(self) -> float:
        """Duration of one character in s.

        A character consists of a start bit, eight data bits, the parity bit (if there is one) and the stop bits.
        """
        # A start bit and eight data bits are always there.
        return (9 + (self.parity != "none") + self.stop_bits) / self.baud

    @property
    def gap_s(self) -> float:
        if self.frame_gap_s is not None:
            return self.frame_gap_s
        return FAST_GAP_S if self.baud > FAST_BAUD else 3.5 * self.character_s

    def exchange_s(self, request: int, answer: int) -> float:
        """Return the transmission time in s of a request and its answer, including the gap before each of them.

        `request` and `answer` are the lengths in bytes of the request and of the answer. They include the function code
        but neither the address nor the CRC.
        """
        # Request and answer each carry one address byte and two CRC bytes.
        characters = request + answer + 2 * ADDRESS_AND_CRC
        return 2.0 * self.gap_s + characters * self.character_s


def crc16(data: bytes) -> int:
    """Return the CRC-16 of `data` (reflected polynomial 0xA001, initial value 0xFFFF).

    The low byte of the CRC is sent first.
    """
    crc = 0xFFFF
    for byte in data:
        # One table look-up does the eight shifts of a byte at once, because the CRC is linear over XOR.
        crc = crc >> 8 ^ _CRC_TABLE[(crc ^ byte) & 0xFF]
    return crc


def build_frame(unit: int, body: bytes) -> bytes:
    frame = bytes((unit,)) + body
    return frame + crc16(frame).to_bytes(2, "little")


def has_valid_crc(frame: bytes) -> bool:
    return len(frame) >= SHORTEST_FRAME and crc16(frame[:-2]) == int.from_bytes(frame[-2:], "little")


def _crc_of_byte(byte: int) -> int:
    for _ in range(8):
        byte = byte >> 1 ^ (0xA001 if byte & 1 else 0)
    return byte


_CRC_TABLE = tuple(_crc_of_byte(byte) for byte in range(256))
