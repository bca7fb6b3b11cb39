"""Polar coordinates @ (distance) and ^ (angle in degrees) of LinuxCNC, converted to X and Y."""

from __future__ import annotations

import math

from gcode.flattening.statements import BlockWord
from gcode.flattening.system_parameters import program_position
from gcode.modal import ModalState
from gcode.source import SourceLine

_XY_PLANE = 170


def cartesian(words: tuple[BlockWord, ...], source: SourceLine, modal: ModalState) -> tuple[BlockWord, ...]:
    """Return the words with X and Y instead of @ and ^. Words without these two are returned unchanged.

    With G90, they are the polar coordinates of the end; the missing one is that of the present position. With G91, they
    are added to the polar coordinates of the present position.
    """
    polar = {word.letter: word.value for word in words if word.letter in "@^"}
    if not polar:
        return words
    others = [word for word in words if word.letter not in "@^"]
    if any(word.letter in "XY" for word in others):
        source.refuse("X or Y together with polar coordinates")
    if modal.plane != _XY_PLANE:
        source.refuse("polar coordinates need G17")
    x, y, _ = program_position(modal, source)
    if math.hypot(x, y) == 0.0 and (not modal.absolute or "^" not in polar):
        source.refuse("the position is the origin, which has no angle")
    distance, angle = math.hypot(x, y), math.atan2(y, x)
    if modal.absolute:
        distance = polar.get("@", distance)
        angle = math.radians(polar["^"]) if "^" in polar else angle
    else:
        distance += polar.get("@", 0.0)
        angle += math.radians(polar.get("^", 0.0))
    end_x, end_y = distance * math.cos(angle), distance * math.sin(angle)
    # The end is known in absolute coordinates; with G91 the words are its difference from the present position.
    if not modal.absolute:
        end_x, end_y = end_x - x, end_y - y
    return (*others, BlockWord.of("X", end_x), BlockWord.of("Y", end_y))
