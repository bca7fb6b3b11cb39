"""Polar coordinates in canned cycles, converted to X and Y; those of other blocks are left to the interpreter."""

from __future__ import annotations

from gcode.flattening.statements import BlockWord
from gcode.flattening.system_parameters import program_position
from gcode.modal import XY_PLANE, ModalState
from gcode.polar import POLAR, polar_end
from gcode.source import SourceLine


def cartesian(words: tuple[BlockWord, ...], source: SourceLine, modal: ModalState) -> tuple[BlockWord, ...]:
    """Return the words of a cycle with X and Y instead of @ and ^. Words without these two are returned unchanged.

    `modal` is the state in which the cycle runs: the other codes of its block have been executed.
    """
    polar = {word.letter: word.value for word in words if word.letter in POLAR}
    if not polar:
        return words
    others = [word for word in words if word.letter not in POLAR]
    if any(word.letter in "XY" for word in others):
        source.refuse("X or Y together with polar coordinates")
    if modal.plane != XY_PLANE:
        source.refuse("polar coordinates need G17")
    x, y, _ = program_position(modal, source)
    end_x, end_y = polar_end(x, y, polar.get("@"), polar.get("^"), absolute=modal.absolute, source=source)
    # The end is known in absolute coordinates; with G91 the words are its difference from the present position.
    if not modal.absolute:
        end_x, end_y = end_x - x, end_y - y
    return (*others, BlockWord.of("X", end_x), BlockWord.of("Y", end_y))
