"""Setup of a part program that the program itself does not state.

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
    """Setup of a part program. All lengths are in mm, all positions are axis positions (machine coordinates).

    `work_offsets`: axis positions of the zero points of G54 and so on; `reference_points`: end points of G28 and G30;
    `tools`: map from the number of H to the length that G43 adds to the programmed position; `g92`: G92 offset that an
    earlier program has left in effect. `start`: position of the axes before the first line, None if it is unknown.
    `tool_change_moves`: True if M6 may move the axes.
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
    tool_change_moves: bool = True


@dataclass(frozen=True)
class CorrectionOptions:
    """Options of the correction.

    `max_chord_error_mm`: largest permissible distance of the written lines from the corrected curve, rounding included.
    `decimals`: number of decimals of a coordinate in mm; coordinates in inches have one more. `outside`: behaviour
    beyond the table's volume. `kept_g`: G codes, as ten times their number, that are passed on although they are not
    supported.
    """

    max_chord_error_mm: float
    decimals: int = 4
    outside: Literal["refuse", "clamp"] = "refuse"
    divide_rapids: bool = False
    kept_g: frozenset[int] = frozenset()
