"""Parsing of one line of a part program into words.

Two words of LinuxCNC are passed on: the number of the spindle (`$0`), and a feed or speed that the controller reads
from a signal (`F#<_hal[NAME]>`).

A word is a letter followed by a decimal number (RS-274/NGC, NISTIR 6556, section 3.3); the `@` and `^` of polar
coordinates count as letters. Computed numbers (expressions,
parameters) and jumps (O-words) have been executed before, see `flattening`.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, field
from functools import lru_cache
from typing import NoReturn

from gcode.source import SourceLine

_WORD = re.compile(r"([A-Z@^]|(?<=.)\$)[ \t]*([-+]?(?:\d+\.?\d*|\.\d+)|(?<=[FS])#<_HAL\[[^\[\]<>]*\]>)|([^ \t])")
LARGEST_NUMBER = 1e9
"""Larger numbers are refused: no word of a controller has so many digits."""
_NUMBER = r"([-+]?(?:\d{1,9}(?:\.\d*)?|\.\d+))"
# The words in the order in which post-processors write them, each at most once and with at most one space behind.
_PLAIN = re.compile(
    r"(?:N(\d+) ?)?(?:G0?([01]) ?)?" + "".join(f"(?:{letter}{_NUMBER} ?)?" for letter in "XYZ") + f"(?:F{_NUMBER})?$"
)
_COMMENT = re.compile(r"\([^()]*\)|;.*")
_PROGRAM_NUMBER = re.compile(r"O\d+$")
_COMPUTED = re.compile(r"[#\[\]=<>]")
_ROTARY = "ABCUVW"
_FLOW = "variables, expressions and O-words are computed by the controller"


@dataclass(slots=True)
class Block:
    """Words of one line of a part program.

    - `source` is the line of the part program, and `text` is the block, which differs from the line if its numbers were
      computed.
    - `g` and `m` contain ten times the numbers of the G and M words, for example 911 for G91.1.
    - `values` maps each other letter to its number. Each of these letters may occur only once in a line.
    - `tokens` contains all words in their order.
    - `comments` contains the comments as written.
    """

    source: SourceLine
    text: str
    g: list[int] = field(default_factory=list)
    m: list[int] = field(default_factory=list)
    values: dict[str, float] = field(default_factory=dict)
    tokens: list[tuple[str, str, str]] = field(default_factory=list)
    comments: str = ""
    deletable: bool = False

    def refuse(self, message: str, hint: str = "") -> NoReturn:
        self.source.refuse(message, hint)


def read_block(text: str, source: SourceLine) -> Block:
    """Parse a block, the text of which comes from the line `source` of a part program, into words.

    Raises FormatError if the line contains anything other than plain words and comments.
    """
    block = Block(source, text)
    code = text.upper()
    if "(" in code or ";" in code or ")" in code:
        code = _without_comments(block)
    if code.startswith("/"):
        block.deletable, code = True, code[1:]
    block.tokens = _WORD.findall(code)
    values = block.values
    for letter, number, other in block.tokens:
        if letter == "G":
            block.g.append(code_number(number))
        elif letter == "M":
            block.m.append(code_number(number))
        elif letter in values:
            block.refuse(f"the word {letter} occurs twice")
        # The third group of the pattern is any sign at which no word begins.
        elif other:
            _refuse_sign(block, code, other)
        else:
            value = math.nan if number.startswith("#") else float(number)
            if abs(value) > LARGEST_NUMBER:
                block.refuse(f"the number after {letter} has too many digits")
            values[letter] = value
    return block


def read_plain(text: str) -> tuple[str | None, ...] | None:
    """Return the texts of the numbers after N, G, X, Y, Z and F if the line has no other words, otherwise None.

    The words must be in this order, each may occur at most once, and G must be 0 or 1. Nine out of ten lines of a CAM
    program have this form, and a single match with a regular expression parses such a line.
    """
    found = _PLAIN.match(text)
    return found.groups() if found else None


@lru_cache(maxsize=1024)
def code_number(number: str) -> int:
    """Convert the number of a G or M word to ten times its value. For example, `01` gives 10 and `91.1` gives 911.
    Return -1 if the number cannot be a code.
    """
    # Codes have at most one decimal. 1e-6 covers numbers such as 91.1, whose tenfold is not exact in binary.
    tenfold = float(number) * 10.0
    return round(tenfold) if 0.0 <= tenfold < LARGEST_NUMBER and abs(tenfold - round(tenfold)) < 1e-6 else -1


def is_program_number(block: Block) -> bool:
    """Return True if the line contains only a program number, such as `O1234` in Fanuc-like programs."""
    words = "".join(letter + number for letter, number, _ in block.tokens)
    return _PROGRAM_NUMBER.match(words) is not None


def _without_comments(block: Block) -> str:
    block.comments = " ".join(_COMMENT.findall(block.text))
    code = _COMMENT.sub(" ", block.text).upper().lstrip()
    if "(" in code or ")" in code:
        block.refuse("a comment is not closed or is nested in another one")
    return code


def _refuse_sign(block: Block, code: str, sign: str) -> NoReturn:
    if _COMPUTED.search(code):
        block.refuse(f"the tool position is not known: {_FLOW}", "Set the post-processor to write plain numbers")
    if sign == "$":
        block.refuse("a controller command ($) may move the machine", "Send it separately from the program")
    if sign == "/":
        block.refuse("there is a slash within the line", "Block delete must be at the beginning of the line")
    sign = sign if sign.isprintable() else f"the control character {ord(sign)}"
    block.refuse(f"'{sign}' cannot be read as a word with a number")
