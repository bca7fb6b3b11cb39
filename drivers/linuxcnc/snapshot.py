"""Snapshot of the state of LinuxCNC, with positions in mm."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Literal

from drivers.errors import ProtocolError
from drivers.foreign_errors import cause_of
from drivers.linuxcnc.pins import PinValue
from drivers.roles import MotionState

Triple = tuple[float, float, float]

ON = "on"
HELD = "feed held by volcal (HAL signal volcal-hold), because LinuxCNC's task had stopped; a reset aborts the motion"


@dataclass(frozen=True)
class Snapshot:
    """State of LinuxCNC at one instant.

    `position` is the machine position, and `probed` is the machine position latched at the last trip of the probe; both
    are without external offsets. `program_offset` is the machine position minus the programmed position. `errors`
    contains the messages of LinuxCNC since the previous snapshot. `held_by_volcal` is True while volcal holds the feed
    because LinuxCNC's task had stopped during a motion.
    """

    position: Triple
    probed: Triple
    tripped: bool
    deflected: bool
    task_state: str
    mode: str
    outcome: Literal["done", "exec", "error"]
    idle: bool
    paused: bool
    in_position: bool
    homed: bool
    homing: bool
    joint_faults: tuple[int, ...]
    on_limit: tuple[int, ...]
    spindle: bool
    tool: int
    program_offset: Triple
    rotation_deg: float
    modal: tuple[float, ...]
    feed_override: float
    rapid_override: float
    abandoned: bool
    held_by_volcal: bool
    errors: tuple[str, ...]
    monotonic_s: float
    pins: tuple[PinValue, ...]

    @property
    def under_way(self) -> bool:
        return self.outcome == "exec" or not self.idle

    @property
    def state(self) -> MotionState:
        if self.fault:
            return MotionState.FAULT
        if self.paused:
            return MotionState.HELD
        return MotionState.MOVING if self.under_way or self.homing or not self.in_position else MotionState.IDLE

    @property
    def fault(self) -> str:
        """Reason why the machine is not switched on or is held by volcal; an empty string if it is ready."""
        if self.task_state == ON:
            return HELD if self.held_by_volcal else ""
        text = "emergency stop" if self.task_state == "estop" else "machine is off"
        for joints, trouble in ((self.joint_faults, "drive fault"), (self.on_limit, "limit switch")):
            if joints:
                text += f", {trouble} of joint {', '.join(map(str, joints))}"
        return text


def parse_snapshot(status: dict[str, Any], mm_per_unit: float, where: dict[str, str]) -> Snapshot:
    """Convert the answer of the bridge process to the request "status" into a snapshot.

    Raises ProtocolError if a field is missing or invalid, or if a position is not a number: kinematics and external
    offsets may give NaN.
    """
    try:
        offset = status["eoffset"]
        snapshot = Snapshot(
            position=_subtract_offset(status["position"], offset, mm_per_unit),
            probed=_subtract_offset(status["probed"], offset, mm_per_unit),
            deflected=status["probe"],
            outcome=status["state"],
            joint_faults=tuple(status["joint_faults"]),
            on_limit=tuple(status["on_limit"]),
            program_offset=_subtract_offset(status["program_offset"], (0.0, 0.0, 0.0), mm_per_unit),
            modal=tuple(status["modal"]),
            errors=tuple(status["errors"]),
            pins=tuple(status["pins"]),
            **{name: status[name] for name in _COPIED_FIELDS},
        )
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        raise ProtocolError(f"the bridge's status cannot be read: {cause_of(error)}", **where) from error
    for name in _POSITIONS:
        values: Triple = getattr(snapshot, name)
        if not all(map(math.isfinite, values)):
            raise ProtocolError(
                f"LinuxCNC reports a position that is no number: {name} {values}",
                hint="check the kinematics, the external offsets (axis.x.eoffset) and the position feedback in HAL",
                **where,
            )
    return snapshot


_POSITIONS = ("position", "probed", "program_offset")
_COPIED_FIELDS = (
    "tripped",
    "task_state",
    "mode",
    "idle",
    "paused",
    "in_position",
    "homed",
    "homing",
    "spindle",
    "tool",
    "rotation_deg",
    "feed_override",
    "rapid_override",
    "abandoned",
    "held_by_volcal",
    "monotonic_s",
)


def _subtract_offset(values: Any, offset: Any, mm_per_unit: float) -> Triple:
    # The bridge reports in machine units, and its positions contain the external offsets.
    x, y, z = ((value - part) * mm_per_unit for value, part in zip(values, offset, strict=True))
    return x, y, z
