r"""Tape format for parameters: a mark ``%``, then blocks of words, then a second mark ``%``.

Each block ends with LF.

::

    %
    N00010Q1P00000001                     parameter 10, bits
    N01320Q1A1M4000.0A2M1300.0            parameter 1320 of each axis, metric
    %

Source: FANUC B-63950EN/02 (30i parameter manual), chapter 3, "Inputting and outputting parameters through the
reader/puncher interface"; B-63330EN/03 (15i) for the form without Q.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass
from decimal import Decimal

MARK = "%"
END_OF_BLOCK = "\n"
_WORD = re.compile(r"([A-Z])([+-]?(?:\d+\.?\d*|\.\d+))")
_COMMENT = re.compile(r"\([^()\n]*\)")
BITS = re.compile(r"[01]{8}")


class TapeError(ValueError):
    """Error for a text that is not a valid tape. The message names the block."""


@dataclass(frozen=True)
class Word:
    """Word of a tape: a letter and a number (`text`), as written on the tape. Leading zeros are significant in bit
    parameters.
    """

    letter: str
    text: str

    def same_as(self, other: Word) -> bool:
        """Return True if both words have the same letter and equal numbers.

        A number written as exactly eight digits 0 or 1 is a bit pattern and is compared as text. Other numbers are
        compared by value.
        """
        if self.letter != other.letter:
            return False
        if BITS.fullmatch(self.text) or BITS.fullmatch(other.text):
            return self.text == other.text
        # Decimal and not float: 1300.0 equals 1300, and no digit is lost.
        return Decimal(self.text) == Decimal(other.text)

    def __str__(self) -> str:
        return f"{self.letter}{self.text}"


Block = tuple[Word, ...]


@dataclass(frozen=True)
class Tape:
    """Contents of a tape, as the blocks of words between its two marks ``%``."""

    blocks: tuple[Block, ...]

    def text(self) -> str:
        lines = ("".join(map(str, block)) for block in self.blocks)
        return END_OF_BLOCK.join((MARK, *lines, MARK)) + END_OF_BLOCK


def parse_tape(text: str) -> Tape:
    """Parse a tape, ignoring text before the first mark ``%`` (a label) and after the second mark.

    Raises TapeError if the text is not a valid tape.
    """
    first, second = text.find(MARK), text.find(MARK, text.find(MARK) + 1)
    if first < 0 or second < 0:
        raise TapeError(f"a tape begins and ends with {MARK}; found {text.count(MARK)} of them")
    blocks = []
    lines = text[first + 1 : second].split(END_OF_BLOCK)
    for number, line in enumerate(lines, start=1):
        if line.strip("; "):
            blocks.append(_block(line, number))
    return Tape(tuple(blocks))


def _block(line: str, number: int) -> Block:
    bare = _COMMENT.sub("", line).rstrip("; ")
    words = []
    position = 0
    while position < len(bare):
        match = _WORD.match(bare, position)
        if match is None:
            raise TapeError(f"block {number} is not a sequence of words: {line!r}")
        words.append(Word(match[1], match[2]))
        position = match.end()
    return tuple(words)


@dataclass(frozen=True)
class TapeDifference:
    """Parameter whose value read back differs from the value written. `found` is None if the parameter is missing."""

    number: int
    axis: str
    expected: Word
    found: Word | None

    def __str__(self) -> str:
        where = f"N{self.number}{self.axis}"
        return f"{where}: wrote {self.expected}, " + ("not there" if self.found is None else f"reads {self.found}")


def differences(expected: Tape, found: Tape) -> list[TapeDifference]:
    """Return the parameters of `expected` whose values are missing or different in `found`.

    Additional parameters in `found` are ignored. Raises TapeError if a block is not a parameter.
    """
    actual = dict(_values(found.blocks))
    found_differences = []
    for (number, axis), word in _values(expected.blocks):
        other = actual.get((number, axis))
        if other is None or not word.same_as(other):
            found_differences.append(TapeDifference(number, axis, word, other))
    return found_differences


def _values(blocks: Iterable[Block]) -> Iterable[tuple[tuple[int, str], Word]]:
    """Yield ((parameter, axis or spindle), value) for each value on the tape."""
    for block in blocks:
        number: int | None = None
        axis = ""
        for word in block:
            match word.letter:
                case "N":
                    number = int(Decimal(word.text))
                case "A" | "S":
                    axis = f"{word.letter}{int(Decimal(word.text))}"
                case "Q" | "O" | "G":
                    pass
                case _ if number is None:
                    raise TapeError(f"a value without a parameter: {''.join(map(str, block))}")
                case _:
                    yield (number, axis), word
