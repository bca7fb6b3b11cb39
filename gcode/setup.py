"""Information that is needed to interpret a part program, but is not contained in the program itself.

It consists of work offsets, tool lengths and the initial state of the controller.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

Triple = tuple[float, float, float]

SYSTEMS = ("G54", "G55", "G56", "G57", "G58", "G59", "G59.1", "G59.2", "G59.3")
NO_OFFSET: Triple = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class PartSetup:
    """Setup of a part program. All lengths are in mm, and all positions are axis positions (machine coordinates).

    - `work_offsets` contains the axis positions of the zero points of G54 and the other coordinate systems.
    - `reference_points` contains the reference points stored in the controller, at which G28 and G30 end.
    - `tools` maps an H number to the length that G43 adds to the programmed position.
    - `g92` is the G92 offset that an earlier program has left in effect.
    - `start` is the position of the axes before the first line, or None if it is unknown.
    - `retract` is the level to which canned cycles return before the program chooses one: G98 is the initial level, G99
      is R. None means that it is not known.
    - `tool_change_moves` is True if M6 may move the axes.
    - `parameters` maps numbers (`100`) and names (`_depth`) of parameters to the values that they have in the
      controller before the program.
    """

    work_offsets: Mapping[str, Triple] = field(default_factory=dict)
    reference_points: Mapping[str, Triple] = field(default_factory=dict)
    tools: Mapping[int, Triple] = field(default_factory=dict)
    start: Triple | None = None
    g92: Triple = NO_OFFSET
    system: str = "G54"
    units: Literal["G20", "G21"] = "G21"
    distance: Literal["G90", "G91"] = "G90"
    arc_centres: Literal["G90.1", "G91.1"] = "G91.1"
    plane: Literal["G17", "G18", "G19"] = "G17"
    feed: Literal["G93", "G94", "G95"] = "G94"
    retract: Literal["G98", "G99"] | None = None
    tool_change_moves: bool = True
    parameters: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class CorrectionOptions:
    """Options for the correction of a part program.

    - `max_chord_error_mm` is the largest permissible distance between the written straight lines and the corrected
      curve, including the rounding of the words.
    - `decimals` is the number of decimals of a coordinate in mm. A coordinate in inches has one more.
    - `outside` determines whether a point outside the volume of the table is refused ("refuse") or corrected as at the
      border of the table ("clamp").
    - `kept_g` contains G codes that are passed on unchanged although they are not supported, as ten times their number.
    """

    max_chord_error_mm: float
    decimals: int = 4
    outside: Literal["refuse", "clamp"] = "refuse"
    divide_rapids: bool = False
    kept_g: frozenset[int] = frozenset()
