"""Conversion of values to registers and back, according to the register map of the panel gateway."""

from __future__ import annotations

import math
import unicodedata
from collections.abc import Sequence

from agent.service.gateway.registers import UNKNOWN, Form, Register

_ASCII_FOR = str.maketrans({"µ": "u", "μ": "u", "°": " deg", "–": "-", "—": "-", "…": "...", "ß": "ss", "·": "-"})
_LIMITS = {Form.U16: (0, 0xFFFF), Form.U32: (0, 0xFFFFFFFF), Form.I32: (-0x80000000, 0x7FFFFFFF)}


def number_words(register: Register, value: float | None) -> tuple[int, ...]:
    """Return the contents of the 16-bit registers (words) that encode a number, after rounding it and clipping it to
    the range of the register. If the number is None or NaN, return the value that means "unknown" in this register."""
    if value is None or math.isnan(value):
        whole = UNKNOWN[register.form]
    else:
        low, high = _LIMITS[register.form]
        whole = round(min(max(value, low), high))
    if register.words == 1:
        return (whole & 0xFFFF,)
    return ((whole >> 16) & 0xFFFF, whole & 0xFFFF)


def text_words(register: Register, text: str) -> tuple[int, ...]:
    """Return the contents of the 16-bit registers (words) that encode a text. The text is transliterated to ASCII, then
    truncated or padded with zeros to the length of the register."""
    plain = unicodedata.normalize("NFKD", text.translate(_ASCII_FOR))
    kept = "".join(c for c in plain if not unicodedata.combining(c))
    data = kept.encode("ascii", "replace")[: 2 * register.words].ljust(2 * register.words, b"\0")
    return tuple(int.from_bytes(data[at : at + 2]) for at in range(0, len(data), 2))


def whole_number(words: Sequence[int]) -> int:
    """Return the unsigned number encoded in `words`, the contents of consecutive 16-bit registers, of which the first
    is the high word."""
    number = 0
    for word in words:
        number = number << 16 | word
    return number


def plain_text(words: Sequence[int]) -> str | None:
    """Return the text encoded in `words`, the contents of consecutive 16-bit registers, without trailing zeros and
    blanks. Return None if the text is not printable ASCII, or if other characters follow a zero."""
    text, *after = b"".join(word.to_bytes(2) for word in words).rstrip(b"\0 ").split(b"\0")
    if after or not all(0x20 <= byte < 0x7F for byte in text):
        return None
    return text.decode("ascii")
