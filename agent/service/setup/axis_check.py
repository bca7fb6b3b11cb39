"""Check of axis letters, signs and kinematic chain by a person who jogs each axis with the controller's own panel.

The controller reports which axis position changed and in which direction. The person saw how the tool went relative to
the workpiece, and whether the tool or the workpiece moved. Positive is the direction in which the tool goes relative to
the workpiece towards the positive end of the axis (ISO 841), whichever of the two moves.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum

from twin.machine.kinematic_chain import AXES, Chain

LEAST_JOG_MM = 1.0
"""Least change of an axis position that counts as a jog; a person cannot judge the direction of a smaller one."""
STILL_MM = 0.05
"""Largest change of the position of an axis that stands still."""


class Direction(Enum):
    """Direction in which the tool went relative to the workpiece, against the arrow in the drawing."""

    AS_DRAWN = "as drawn"
    OPPOSITE = "opposite"
    ACROSS = "across"


class Part(Enum):
    """Part of the machine that moved during a jog, according to the person who watched it."""

    TOOL = "tool"
    WORKPIECE = "workpiece"


class Finding(Enum):
    """Result of the check of one axis."""

    GOOD = "good"
    OTHER_AXIS = "other axis"
    SEVERAL_AXES = "several axes"
    WRONG_SIGN = "wrong sign"
    WRONG_DIRECTION = "wrong direction"
    WRONG_SIDE = "wrong side"


@dataclass(frozen=True)
class Jog:
    """Change of the axis positions in mm while a person jogged the axis `asked`."""

    asked: str
    change_mm: tuple[float, float, float]

    @property
    def moved(self) -> tuple[str, ...]:
        """Letters of the axes that moved, the longest way first. None has moved until one has gone `LEAST_JOG_MM`."""
        ways = sorted(zip(AXES, self.change_mm, strict=True), key=lambda pair: -abs(pair[1]))
        if abs(ways[0][1]) < LEAST_JOG_MM:
            return ()
        return tuple(letter for letter, change in ways if abs(change) > STILL_MM)

    @property
    def distance_mm(self) -> float:
        """Change of the position of the axis that went farthest."""
        return max(self.change_mm, key=abs)


@dataclass(frozen=True)
class JogObservation:
    """Motion that a person saw during a jog."""

    jog: Jog
    direction: Direction
    part: Part

    def finding(self, chain: Chain) -> Finding:
        """Return what the jog says about letters, signs and `chain`."""
        if len(self.jog.moved) > 1:
            return Finding.SEVERAL_AXES
        if self.jog.moved != (self.jog.asked,):
            return Finding.OTHER_AXIS
        if self.direction is Direction.OPPOSITE:
            return Finding.WRONG_SIGN
        if self.direction is Direction.ACROSS:
            return Finding.WRONG_DIRECTION
        side = Part.TOOL if self.jog.asked in chain.tool_side else Part.WORKPIECE
        return Finding.GOOD if side is self.part else Finding.WRONG_SIDE


class ProbeFinding(Enum):
    """State of the check of the probe input, for which a person deflects the stylus with a finger."""

    WAITING = "waiting"
    HELD = "held"
    GOOD = "good"
    ALWAYS_ON = "always on"


def judge_trigger(deflected: Sequence[bool]) -> ProbeFinding:
    """Return the finding from the observed states of the probe input, given in the order of observation.

    The input is good if it was off, went on while the stylus was deflected, and went off again. An input that has never
    been off is reported as always on.
    """
    if not deflected or not any(deflected):
        return ProbeFinding.WAITING
    if all(deflected):
        return ProbeFinding.ALWAYS_ON
    first_off = deflected.index(False)
    if True not in deflected[first_off:]:
        return ProbeFinding.WAITING
    return ProbeFinding.HELD if deflected[-1] else ProbeFinding.GOOD
