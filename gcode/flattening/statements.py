"""Statement in one line of a part program: words with computed numbers, and assignments of parameters."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

from gcode.flattening.expressions import ExpressionReader
from gcode.flattening.parameters import Key, ProgramParameters
from gcode.source import SourceLine
from gcode.words import code_number

# A picometre in mm; no controller resolves more.
_DECIMALS = 9
_SHOWN = re.compile(r"\(\s*(?:debug|print|log)\s*,", re.IGNORECASE)
_SIGNAL = re.compile(r"#<_hal\[[^\[\]<>]*\]>")


class BlockWord(NamedTuple):
    """Word of a block: a letter (or @ or ^ of polar coordinates), its number, and the number as text."""

    letter: str
    value: float
    text: str

    @classmethod
    def of(cls, letter: str, value: float) -> BlockWord:
        return cls(letter, value, number_text(value))


@dataclass(frozen=True, slots=True)
class Statement:
    """Contents of one line. `computed` is True if a number of the words was not written as a plain number.

    All numbers are computed with the parameters as they were before the line; the assignments take effect after it.
    """

    source: SourceLine
    words: tuple[BlockWord, ...]
    assignments: tuple[tuple[Key, float], ...]
    comments: tuple[str, ...]
    deletable: bool
    computed: bool

    def codes(self, letter: str) -> list[int]:
        """Ten times the numbers of the G or M words."""
        return [code_number(word.text) for word in self.words if word.letter == letter]

    def value(self, letter: str) -> float | None:
        """Return the number of the first word with this letter, or None if there is none."""
        return next((word.value for word in self.words if word.letter == letter), None)


def read_statement(source: SourceLine, parameters: ProgramParameters) -> Statement:
    """Read a line. Raises FormatError if it cannot be read."""
    code, comments = source.split_comments()
    deletable = code.startswith("/")
    reader = ExpressionReader(source, code.lstrip("/"), parameters)
    words: list[BlockWord] = []
    assignments: list[tuple[Key, float]] = []
    while reader.next:
        letter = reader.next
        if letter == "#":
            key = reader.key()
            reader.skip("=")
            assignments.append((key, reader.value()))
        elif letter.isascii() and (letter.isalpha() or letter in "@^$"):
            reader.at += 1
            begin = reader.at
            signal = _SIGNAL.match(reader.code, begin) if letter in "fs" else None
            if signal is not None:
                words.append(BlockWord(letter.upper(), math.nan, signal[0]))
                reader.at = signal.end()
                continue
            value = reader.value()
            text = reader.code[begin : reader.at]
            # A number that was written plainly keeps its text, so that its line stays as the programmer wrote it.
            plain = text.replace(".", "").lstrip("+-").isdecimal()
            words.append(BlockWord(letter.upper(), value, text if plain else number_text(value)))
        else:
            shown = letter if letter.isprintable() else f"the control character {ord(letter)}"
            source.refuse(f"'{shown}' cannot be read as a word with a number")
    return Statement(source, tuple(words), tuple(assignments), tuple(comments), deletable, reader.computed)


def block_text(words: Sequence[BlockWord], comments: Sequence[str] = ()) -> str:
    """Return the text of a block. Comments that show parameters are omitted, because the block has none."""
    shown = [comment for comment in comments if not shows_parameters(comment)]
    return " ".join([*(word.letter + word.text for word in words), *shown])


def shows_parameters(comment: str) -> bool:
    """Return True if the controller would show the values of parameters."""
    return "#" in comment and _SHOWN.match(comment) is not None


def number_text(value: float) -> str:
    """Return a number as text with at most nine decimals."""
    text = f"{value:.{_DECIMALS}f}".rstrip("0").rstrip(".")
    return "0" if text == "-0" else text
