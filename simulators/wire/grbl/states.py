"""States and status of a simulated GRBL controller, and the numbers of its alarms and errors outside of blocks.

Source: gnea/grbl, doc/csv/alarm_codes_en_US.csv and error_codes_en_US.csv.
"""

from __future__ import annotations

from enum import Enum
from typing import Final

from simulators.wire.grbl.axes import GrblAxes
from simulators.wire.grbl.blocks import BlockParser
from simulators.wire.grbl.reports import StatusSnapshot

HARD_LIMIT, SOFT_LIMIT, ABORTED, NOT_READY, NO_CONTACT, HOMING_RESET = 1, 2, 3, 4, 5, 6
CRITICAL: Final = frozenset({HARD_LIMIT, SOFT_LIMIT})
BAD_NUMBER, NOT_RECOGNISED, HOMING_DISABLED, NOT_IDLE, LOCKED, OVERFLOW, DOOR_OPEN = 2, 3, 5, 8, 9, 11, 13
BEYOND_TRAVEL = 15


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
