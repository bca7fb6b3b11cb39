"""Formatting of the program lines for a move."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

from gcode.source import SourceLine

# Bits 1, 2 and 4 for X, Y and Z.
ALL_AXES = 7


class MoveBlock(NamedTuple):
    """Block of a part program that commands a move.

    - `source` is the line of the part program that contains the block.
    - `head` and `tail` are the texts before and after the axis words.
    - `code` is the code to be written, G0 or G1. `coded` is True if the block itself contains the code.
    - `machine` is True if the positions are machine coordinates (G53).
    - `mask` is a bit mask of the axes named in the block.
    - `stop` contains the words that take effect after the motion.
    - `comment` is the comment at the end of the line.
    - `inverse` is the value of F of a feed move if G93 (inverse-time feed) is in effect, else 0.
    - `whole` is the reason why the move must not be divided. It is an empty string if the move may be divided.
    """

    source: SourceLine
    code: str
    coded: bool
    machine: bool
    mask: int
    head: str
    tail: str
    stop: str
    comment: str
    inverse: float
    whole: str


class LineFormatter:
    """Formatter of the lines for successive moves.

    The formatter tracks the motion code (G0 or G1) in effect. `forget` must be called if this code is no longer known.
    """

    def __init__(self, decimals: int) -> None:
        x, y, z = (f"{letter}%.{decimals}f" for letter in "XYZ")
        # The index of a form is the bit mask of its axes.
        self._forms = ["", x, y, f"{x} {y}", z, f"{x} {z}", f"{y} {z}", f"{x} {y} {z}"]
        self._code = ""

    def forget(self) -> None:
        self._code = ""

    def line(self, move: MoveBlock, values: Sequence[float], axes: int) -> str:
        """Return the program line that commands a move that was not divided into pieces. `axes` is a bit mask of the
        axis words to be written.
        """
        words = self._axis_words(values, axes)
        code = self._motion(move, forced=move.coded)
        if not (move.stop or move.inverse):
            return f"{move.head}{code}{words}{move.tail}{move.comment}"
        feed = f" F{_number(move.inverse)}" if move.inverse else ""
        return f"{move.head}{code}{words}{feed}{move.tail}{move.stop}{move.comment}"

    def lines(self, move: MoveBlock, values: Sequence[Sequence[float]], axes: Sequence[int]) -> Iterator[str]:
        """Yield the program lines of a move that was divided into pieces.

        A piece gets a line if at least one of its rounded axis words changes. The last piece always gets a line.

        With G93 (inverse-time feed), F is the reciprocal of the duration of a line's motion in minutes. The value of F
        in each line is therefore computed from the line's share of the total duration.
        """
        count, waiting, first = len(values), 0, True
        for number, (piece, bits) in enumerate(zip(values, axes, strict=True), start=1):
            waiting += 1
            if not bits and number < count:
                continue
            head, tail, comment = (move.head, move.tail, move.comment) if first else ("", "", "")
            stop = move.stop if number == count else ""
            code = self._motion(move, forced=first)
            # The line covers `waiting` of `count` equal pieces, and therefore takes this share of the time.
            feed = f" F{_number(move.inverse * count / waiting)}" if move.inverse else ""
            yield f"{head}{code}{self._axis_words(piece, bits)}{feed}{tail}{stop}{comment}"
            waiting, first = 0, False

    def _axis_words(self, values: Sequence[float], axes: int) -> str:
        if axes == ALL_AXES:
            return self._forms[ALL_AXES] % (values[0], values[1], values[2])
        return self._forms[axes] % tuple(value for k, value in enumerate(values) if axes >> k & 1)

    def _motion(self, move: MoveBlock, forced: bool) -> str:
        if move.machine:
            self._code = move.code
            return f"G53 {move.code} "
        if not forced and self._code == move.code:
            return ""
        self._code = move.code
        return f"{move.code} "


def _number(value: float) -> str:
    return f"{value:.6f}".rstrip("0").rstrip(".")
