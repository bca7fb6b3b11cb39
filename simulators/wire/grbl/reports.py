"""States of GRBL 1.1 and grblHAL, the numbers of their alarms and of their errors outside of blocks, and the texts that
they send: status reports, parameters, parser state.

Source: gnea/grbl, doc/markdown/interface.md, doc/csv/alarm_codes_en_US.csv and error_codes_en_US.csv; grblHAL/core,
report.c.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from enum import Enum
from typing import Final

from simulators.wire.grbl.axes import GrblAxes
from simulators.wire.grbl.blocks import MM_PER_INCH, BlockParser, GrblModalState, Triple, WorkOffsets
from simulators.wire.grbl.settings import GrblSettings

HARD_LIMIT, SOFT_LIMIT, ABORTED, NOT_READY, NO_CONTACT, HOMING_RESET = 1, 2, 3, 4, 5, 6
CRITICAL: Final = frozenset({HARD_LIMIT, SOFT_LIMIT})
BAD_NUMBER, NOT_RECOGNISED, HOMING_DISABLED, NOT_IDLE, LOCKED, OVERFLOW, DOOR_OPEN = 2, 3, 5, 8, 9, 11, 13
BEYOND_TRAVEL = 15
HOW_TO_UNLOCK = "[MSG:'$H'|'$X' to unlock]"
RESET_TO_CONTINUE = "[MSG:Reset to continue]"
UNLOCKED = "[MSG:Caution: Unlocked]"
CHECK_DOOR = "[MSG:Check Door]"
PROGRAM_END = "[MSG:Pgm End]"
HELP = "[HLP:$$ $# $G $I $N $x=val $Nx=line $J=line $SLP $C $X $H ~ ! ? ctrl-x]"

MACHINE_POSITION, BUFFER_STATE = 1, 2
OFFSET_EVERY = {True: 30, False: 10}
OVERRIDES_EVERY = {True: 20, False: 10}
"""Number of reports between two override fields; the key is True if the machine is moving."""


@dataclass(frozen=True)
class StatusSnapshot:
    """State of a GRBL controller at one instant, with lengths in mm in machine coordinates.

    `state` is the name of the state with its sub-state, if there is one (``Hold:0``).
    """

    state: str
    moving: bool
    position_mm: Triple
    work_offset_mm: Triple
    planned_blocks: int
    feed_mm_per_min: float
    speed_rpm: float
    pins: str
    accessories: str
    homed: bool = True
    overrides: tuple[int, int, int] = (100, 100, 100)


class StatusReporter:
    """Formatter of GRBL status reports, which selects the fields of each report.

    The work offset and the overrides are contained only in some reports, at regular intervals and after each change.
    """

    def __init__(self, settings: GrblSettings) -> None:
        self._settings = settings
        self.restart()

    def restart(self) -> None:
        """Restart the counting of reports after a reset.

        The next report contains the work offset, and the report after it contains the overrides.
        """
        self._until_offset, self._until_overrides = 0, 1
        self._shown_offset: Triple | None = None
        self._shown_others: tuple[tuple[int, int, int], str] | None = None
        self.report_homed()

    def report_homed(self) -> None:
        """Let the next report contain whether the machine has homed, if the firmware reports this."""
        self._homed_due = self._settings.dialect.reports_homed

    def report(self, now: StatusSnapshot, waiting_bytes: int) -> str:
        machine = bool(int(self._settings[10]) & MACHINE_POSITION)
        shown = now.position_mm if machine else _less(now.position_mm, now.work_offset_mm)
        fields = [now.state, f"{'MPos' if machine else 'WPos'}:{self._coordinates(shown)}"]
        if int(self._settings[10]) & BUFFER_STATE:
            dialect = self._settings.dialect
            free = dialect.planner_blocks - now.planned_blocks, dialect.receive_buffer - waiting_bytes
            fields.append(f"Bf:{free[0]},{free[1]}")
        feed = now.feed_mm_per_min / (MM_PER_INCH if self._settings.flag(13) else 1.0)
        fields.append(f"FS:{feed:.0f},{now.speed_rpm:.0f}")
        if now.pins:
            fields.append(f"Pn:{now.pins}")
        fields += self._intermittent(now)
        if self._homed_due:
            self._homed_due = False
            fields.append(f"H:{int(now.homed)}")
        return "<" + "|".join(fields) + ">"

    def _intermittent(self, now: StatusSnapshot) -> list[str]:
        others = (now.overrides, now.accessories)
        if self._until_offset <= 0 or now.work_offset_mm != self._shown_offset:
            self._until_offset, self._shown_offset = OFFSET_EVERY[now.moving] - 1, now.work_offset_mm
            self._until_overrides -= 1
            return [f"WCO:{self._coordinates(now.work_offset_mm)}"]
        self._until_offset -= 1
        if self._until_overrides <= 0 or (self._shown_others is not None and others != self._shown_others):
            self._until_overrides, self._shown_others = OVERRIDES_EVERY[now.moving] - 1, others
            feed, rapid, spindle = now.overrides
            return [f"Ov:{feed},{rapid},{spindle}"] + ([f"A:{now.accessories}"] if now.accessories else [])
        self._until_overrides -= 1
        return []

    def _coordinates(self, position_mm: Triple) -> str:
        return coordinates(position_mm, inches=self._settings.flag(13))


def coordinates(position_mm: Triple, *, inches: bool) -> str:
    """Return coordinates as text, with three decimals in mm or four decimals in inches."""
    if inches:
        return ",".join(f"{value / MM_PER_INCH:.4f}" for value in position_mm)
    return ",".join(f"{value:.3f}" for value in position_mm)


def probe_message(position_mm: Triple, tripped: bool, *, inches: bool) -> str:
    return f"[PRB:{coordinates(position_mm, inches=inches)}:{int(tripped)}]"


def parameters(offsets: WorkOffsets, modes: GrblModalState, *, inches: bool) -> Iterator[str]:
    """Yield the lines of the answer to ``$#``, except for the last line, which contains the probe result."""
    for system, offset in sorted(offsets.systems.items()):
        yield f"[G{system}:{coordinates(offset, inches=inches)}]"
    for predefined in (28, 30):
        yield f"[G{predefined}:{coordinates((0.0, 0.0, 0.0), inches=inches)}]"
    yield f"[G92:{coordinates(modes.g92_mm, inches=inches)}]"
    length = modes.tool_length_mm / MM_PER_INCH if inches else modes.tool_length_mm
    yield f"[TLO:{length:.{4 if inches else 3}f}]"


def parser_state(modes: GrblModalState) -> str:
    """Return the modal state of the parser as the answer to ``$G``."""
    feed = modes.feed_mm_per_min / (MM_PER_INCH if modes.units == 20 else 1.0)
    words = [f"G{modes.motion:g}", f"G{modes.coordinates}", f"G{modes.plane:g}", f"G{modes.units:g}"]
    words += [f"G{modes.distance:g}", "G94", f"M{modes.spindle:g}", f"M{modes.coolant:g}"]
    return f"[GC:{' '.join(words)} T{modes.tool} F{feed:.0f} S{modes.speed_rpm:.0f}]"


def _less(position: Triple, offset: Triple) -> Triple:
    x, y, z = (a - b for a, b in zip(position, offset, strict=True))
    return x, y, z


class GrblState(Enum):
    IDLE = "Idle"
    RUN = "Run"
    HOLD = "Hold"
    DOOR = "Door"
    ALARM = "Alarm"
    HOME = "Home"
    JOG = "Jog"


def snapshot(state: GrblState, axes: GrblAxes, parser: BlockParser, *, blocks: int, homed: bool) -> StatusSnapshot:
    """Return the state of the controller, whose planner holds `blocks` blocks."""
    modes = parser.modes
    spindle = {3: "S", 4: "C"}.get(int(modes.spindle), "")
    return StatusSnapshot(
        state=_state_shown(state, axes),
        moving=axes.moving,
        position_mm=axes.position(),
        work_offset_mm=parser.work_offset_mm,
        planned_blocks=blocks,
        feed_mm_per_min=axes.feed_mm_per_min,
        speed_rpm=modes.speed_rpm if spindle else 0.0,
        pins="P" * axes.pin + "D" * axes.door_open,
        accessories=spindle + {8: "F", 7: "M"}.get(int(modes.coolant), ""),
        homed=homed,
    )


def _state_shown(state: GrblState, axes: GrblAxes) -> str:
    if state is GrblState.HOLD:
        return f"Hold:{int(axes.moving)}"
    if state is GrblState.DOOR:
        return "Door:2" if axes.moving else f"Door:{int(axes.door_open)}"
    return str(state.value)
