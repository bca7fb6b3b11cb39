"""Modal state of a part program after one line and before the next."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from gcode.setup import NO_OFFSET, SYSTEMS, PartSetup, Triple

MM_PER_INCH = 25.4
INVERSE_TIME = 930
XY_PLANE = 170

UNKNOWN: Triple = (math.nan, math.nan, math.nan)

Frame = tuple[float, float, float, bool]
"""Reference of axis words: axis position (mm) of the controller's zero point, and True if words are absolute."""

MACHINE_FRAME: Frame = (0.0, 0.0, 0.0, True)

SYSTEM_CODES = {round(10.0 * float(name[1:])): name for name in SYSTEMS}


@dataclass(slots=True)
class ModalState:
    """Modal state of the interpreter.

    G codes are stored as ten times their number. Lengths are in mm. Positions are axis positions, or NaN if they are
    unknown. `position` is the programmed axis position, without corrections. `g92` is the G92 offset that the program
    intends, and `g92_written` is the G92 offset that the controller has stored. The two differ by the rounding of the
    written G92 words. In the same way, `work_offsets` are the work offsets that the program intends, and `work_written`
    are those of the controller. `references` contains the reference points of G28 and G30, as the program intends them
    and as the controller has stored them. `begun` is True after the first block.
    `lost_at_tool_change` is True if a tool change has made the position unknown. `words` contains the last words of
    groups that do not change the path, such as the feed (`F`) and the spindle, by the name of the group.
    """

    setup: PartSetup
    position: list[float] = field(init=False)
    motion: int | None = None
    absolute: bool = field(init=False)
    absolute_centres: bool = field(init=False)
    unit_mm: float = field(init=False)
    plane: int = field(init=False)
    feed_mode: int = field(init=False)
    system: str = field(init=False)
    tool_offset: Triple = NO_OFFSET
    g92: Triple = field(init=False)
    g92_written: Triple = field(init=False)
    g92_saved: tuple[Triple, Triple] | None = None
    tool_called: int | None = None
    tool_held: int | None = None
    begun: bool = False
    ended: bool = False
    lost_at_tool_change: bool = False
    words: dict[str, str] = field(default_factory=dict)
    references: dict[str, tuple[Triple, Triple]] = field(init=False)
    work_offsets: dict[str, Triple] = field(init=False)
    work_written: dict[str, Triple] = field(init=False)
    offset: Triple | None = field(init=False)
    frame: Frame = field(init=False)

    def __post_init__(self) -> None:
        setup = self.setup
        self.position = list(setup.start or UNKNOWN)
        self.absolute = setup.distance == "G90"
        self.absolute_centres = setup.arc_centres == "G90.1"
        self.unit_mm = 1.0 if setup.units == "G21" else MM_PER_INCH
        self.plane = 10 * int(setup.plane[1:])
        self.feed_mode = 10 * int(setup.feed[1:])
        self.system = setup.system
        self.references = {name: (point, point) for name, point in setup.reference_points.items()}
        self.work_offsets = dict(setup.work_offsets)
        self.work_written = dict(setup.work_offsets)
        self.g92 = self.g92_written = setup.g92
        self.update_frame()

    @property
    def start_hint(self) -> str:
        """Remedy for the user if the position is unknown."""
        if self.lost_at_tool_change:
            return "If the tool change (M6) does not move the axes: --tool-change stays"
        return "Give the position of the axes at the beginning: --start X,Y,Z"

    def update_frame(self) -> None:
        """Recompute `offset` and `frame` after a change of the state. `offset` is the axis position of the zero point
        that the program intends. `frame` is the zero point that the controller has, and the distance mode. `offset`
        becomes None if the work offset is not known.
        """
        work = self.work_offsets.get(self.system)
        # RS-274/NGC: machine position = word + work offset + G92 offset + tool length.
        self.offset = None if work is None else _sum(work, self.g92, self.tool_offset)
        written = _sum(self.work_written.get(self.system, UNKNOWN), self.g92_written, self.tool_offset)
        self.frame = (*written, self.absolute)

    @property
    def inverse_time(self) -> bool:
        """True if F is the reciprocal of the duration of a move (G93)."""
        return self.feed_mode == INVERSE_TIME

    @property
    def position_known(self) -> bool:
        """True if the positions of all three axes are known."""
        x, y, z = self.position
        return x == x and y == y and z == z  # noqa: PLR0124  NaN alone differs from itself; math.isnan is slower


def _sum(*offsets: Triple) -> Triple:
    x, y, z = (sum(parts) for parts in zip(*offsets, strict=True))
    return x, y, z
