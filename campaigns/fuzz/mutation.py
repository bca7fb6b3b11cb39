"""Mutations of good inputs: altered, missing, repeated and foreign bytes."""

from __future__ import annotations

from collections.abc import Sequence
from random import Random

import numpy as np
from numpy.typing import NDArray

TOKENS: Sequence[bytes] = (
    b"", b"\0", b"\xff", b"\xc2\xb2", b"\xef\xbb\xbf", b"\r", b"\n", b'"', b"'", b",", b";", b".", b"=", b"#",
    b"[", b"]", b"{", b"}", b"(", b")", b"nan", b"inf", b"-inf", b"1e999", b"-1", b"0", b"1e-999", b"null", b"true",
    b"0x7fffffff",
    b"4294967296", b"9" * 30, b"9" * 5000, b"[" * 3000, b"{" * 500, b"(" * 500, b"a." * 400, b"\x1b[2J", b"/" * 300,
)  # fmt: skip
"""Texts at which parsers have failed: limits of numbers, depth, encodings, separators."""
CHANGE_COUNTS = (1, 1, 1, 2, 4)
"""Numbers of changes of one input. Most inputs have one: those with many are refused at the first."""
LONGEST_PIECE = 64
SHORT = 128
"""Number of bytes below which the digits of an input are found sooner without an array."""


def mutated(random: Random, seed: bytes) -> bytes:
    """Return `seed` after one or several changes."""
    data = seed
    for _ in range(random.choice(CHANGE_COUNTS)):
        data = random.choice(_CHANGES)(random, data)
    return data


def _alter(random: Random, data: bytes) -> bytes:
    if not data:
        return bytes((random.randrange(256),))
    place = random.randrange(len(data))
    return data[:place] + bytes((random.randrange(256),)) + data[place + 1 :]


def _remove(random: Random, data: bytes) -> bytes:
    begin, end = _piece(random, data)
    return data[:begin] + data[end:]


def _repeat(random: Random, data: bytes) -> bytes:
    begin, end = _piece(random, data)
    return data[:end] + data[begin:end] * random.choice((1, 1, 2, 50)) + data[end:]


def _insert(random: Random, data: bytes) -> bytes:
    place = random.randint(0, len(data))
    return data[:place] + random.choice(TOKENS) + data[place:]


def _replace_number(random: Random, data: bytes) -> bytes:
    """Replace a run of digits by a token; most limits are limits of numbers."""
    digits = _places_of_digits(data)
    if not len(digits):
        return _insert(random, data)
    begin = int(random.choice(digits))
    end = begin
    while end < len(data) and 0x30 <= data[end] <= 0x39:
        end += 1
    return data[:begin] + random.choice(TOKENS) + data[end:]


def _places_of_digits(data: bytes) -> Sequence[int] | NDArray[np.intp]:
    """Return the places of all digits in ascending order. Python takes longer for a large file than its decoder."""
    if len(data) < SHORT:
        return [place for place, byte in enumerate(data) if 0x30 <= byte <= 0x39]
    values = np.frombuffer(data, dtype=np.uint8)
    return np.flatnonzero((values >= 0x30) & (values <= 0x39))


def _cut(random: Random, data: bytes) -> bytes:
    return data[: random.randint(0, len(data))]


def _exchange(random: Random, data: bytes) -> bytes:
    (a, b), (c, d) = sorted((_piece(random, data), _piece(random, data)))
    return data if b > c else data[:a] + data[c:d] + data[b:c] + data[a:b] + data[d:]


def _piece(random: Random, data: bytes) -> tuple[int, int]:
    begin = random.randint(0, len(data))
    return begin, min(len(data), begin + random.randint(1, LONGEST_PIECE))


_CHANGES = (_alter, _alter, _remove, _repeat, _insert, _replace_number, _replace_number, _cut, _exchange)
