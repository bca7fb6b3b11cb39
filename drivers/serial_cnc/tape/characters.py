"""Tape characters: seven-bit ISO code with even parity in the eighth bit, and the four device controls.

With its parity bit, the device control DC3 is 0x93. The XON/XOFF handshake of a serial driver recognises DC3 only as
0x13. Package `tape` therefore handles flow control itself.

Source: FANUC B-63503EN/02 (Series 0i connection manual, hardware), 5.3 "RS-232-C interface": one parity bit among
eight, DC1 to DC4, two stop bits; ISO 646 for the characters.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

IGNORED = frozenset({0x00, 0x0D, 0x7F, 0x20})
"""Characters without meaning on a tape: blank tape, carriage return, deleted (punched-out) character, space."""


class DeviceControl(IntEnum):
    """Codes of the device controls DC1 to DC4, without the parity bit."""

    READER_START = 0x11
    PUNCH_ON = 0x12
    READER_STOP = 0x13
    PUNCH_OFF = 0x14


_CONTROLS = {control.value: control for control in DeviceControl}


@dataclass(frozen=True)
class ParityFault:
    """Received byte with a parity error: the number of its set bits is odd."""

    byte: int


Character = str | DeviceControl | ParityFault


def with_even_parity(byte: int) -> int:
    """Return the seven-bit code `byte` with even parity in bit 7."""
    return byte | (byte.bit_count() & 1) << 7


def encode(text: str) -> bytes:
    """Encode ASCII text as tape characters. Raises UnicodeEncodeError for other text."""
    return bytes(with_even_parity(byte) for byte in text.encode("ascii"))


def encode_control(control: DeviceControl) -> bytes:
    return bytes((with_even_parity(control),))


def decode(data: bytes) -> list[Character]:
    """Decode tape bytes into characters, device controls and parity faults, one for each byte.

    Bytes without meaning on a tape, such as blank tape and spaces, are omitted.
    """
    characters: list[Character] = []
    for byte in data:
        seven = byte & 0x7F
        if with_even_parity(seven) != byte:
            characters.append(ParityFault(byte))
        elif seven in _CONTROLS:
            characters.append(_CONTROLS[seven])
        elif seven not in IGNORED:
            characters.append(chr(seven))
    return characters
