"""State of a GRBL controller, as known from all status reports so far.

Some fields are contained only in some reports. The last value of such a field is kept until a report contains it again.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from drivers.errors import LinkTimeout, ProtocolError
from drivers.roles import MotionState, Permission, Vector
from drivers.serial_cnc.codes import NEEDS_RESET, POSITION_KEPT, alarm_text
from drivers.serial_cnc.controller_settings import HOMING_OFF, ControllerSettings
from drivers.serial_cnc.conversation import Conversation
from drivers.serial_cnc.lines import GarbledLineError, MessageLine, StatusReport, Triple

REPORTS_UNTIL_OFFSET = 40
"""Number of status reports of which at least one must contain the work offset.

GRBL sends it in every tenth or thirtieth report, and in the first one after a reset.
"""
COORDINATE_SYSTEMS = frozenset(f"G{number}" for number in range(54, 60))
NO_PART_PROGRAM = frozenset({"Idle", "Alarm", "Check", "Sleep", "Door"})
NOT_AUTOMATIC = frozenset({"Check", "Sleep", "Jog", "Home", "Tool"})


@dataclass(frozen=True)
class TrackedStatus:
    """Status report in which missing fields are taken from earlier reports.

    `position_mm` is in machine coordinates, shape (3,).
    """

    word: str
    state: MotionState
    position_mm: Vector
    deflected: bool
    permissions: Mapping[Permission, bool]
    alarm: int | None
    overrides: tuple[int, int]
    """Feed override and rapid override, percent."""
    homes: bool
    """True if the controller homes the machine, or a person sets the axes to their marks."""

    @property
    def fault(self) -> str:
        return alarm_text(self.alarm) if self.state is MotionState.FAULT else ""

    @property
    def slowest_share(self) -> float:
        """Smaller of the feed override and the rapid override, expressed as a speed factor between 0.01 and 1."""
        return max(min(100, *self.overrides), 1) / 100.0

    @property
    def remedy(self) -> str:
        """Instruction for giving the permissions that the machine does not give."""
        if not self.homes:
            return HOMING_OFF
        if not self.permissions[Permission.REFERENCED] or self.alarm not in POSITION_KEPT | {None}:
            return "home the machine ($H), then start again"
        return "make the machine ready: home it, close the door, stop the spindle, end other programs"

    @property
    def missing(self) -> str:
        return ", ".join(name.value for name, given in self.permissions.items() if not given)


class StatusTracker:
    """Record of a GRBL controller's state, kept up to date from its status reports while the device is open."""

    def __init__(self, conversation: Conversation, settings: ControllerSettings, *, by_hand: bool) -> None:
        self._conversation = conversation
        self._settings = settings
        self._homing_known = settings.homes or by_hand
        self._restarts = conversation.restarts
        self._offset: Triple | None = None
        self._overrides = (100, 100)
        self._spindle_turns = False
        self._homed: bool | None = None
        self._alarm: int | None = None
        self._in_alarm = False
        self.own_motion = False
        """True while a motion of this driver is in progress."""
        self.position_lost = False
        self.unexpected_restarts = 0
        """Number of restarts that this driver did not request."""

    def set_work_offset(self, lines: list[MessageLine], modes: str) -> None:
        """Set the work offset (machine position minus work position) from the answers to ``$#`` and ``$G``.

        If these answers cannot be interpreted, the offset is taken from a later status report.
        """
        offsets = {message.kind: message for message in lines}
        system = next((word for word in modes.split() if word in COORDINATE_SYSTEMS), None)
        try:
            parts = [offsets[str(system)].triple(), offsets["G92"].triple(), _tool_offset(offsets["TLO"])]
        except (KeyError, GarbledLineError):
            return
        x, y, z = (sum(values) for values in zip(*parts, strict=True))
        self._offset = (x, y, z)

    def read_status(self) -> TrackedStatus:
        """Query the status and return it.

        After a critical alarm, the controller gives no answer until it is reset. In this case the method resets the
        controller first. The reset moves no axis.
        """
        conversation = self._conversation
        try:
            report = None if conversation.alarm in NEEDS_RESET else conversation.report()
        except LinkTimeout:
            if conversation.alarm not in NEEDS_RESET:
                raise
            report = None
        if report is None:
            alarm = conversation.alarm
            self._note_restart(expected=True)
            conversation.reset()
            self._note_restart(expected=True)
            report = conversation.report()
            self._alarm = conversation.alarm if conversation.alarm is not None else alarm
        return self._interpret(report)

    def note_homed(self) -> None:
        """Record that the controller has homed all axes, so the position is known again."""
        self.position_lost = False

    def expect_restart(self) -> None:
        """Discard the state that a reset by this driver has cleared. The position is kept. Call this method after the
        reset.
        """
        self._note_restart(expected=True)

    def work_offset(self) -> Vector:
        """Return the work offset in mm, shape (3,): machine position = work position + offset.

        Queries the status until a report contains the offset. Raises ProtocolError if `REPORTS_UNTIL_OFFSET` reports
        have come without the offset.
        """
        for _ in range(REPORTS_UNTIL_OFFSET):
            if self._offset is not None:
                return np.array(self._offset)
            self.read_status()
        raise ProtocolError(
            f"no work offset (WCO) in {REPORTS_UNTIL_OFFSET} reports",
            hint="enable it in the report mask $10",
            **self._conversation.where,
        )

    def _interpret(self, report: StatusReport) -> TrackedStatus:
        self._note_restart(expected=False)
        self._note_fields(report)
        self._note_alarm(report)
        position = report.triple("MPos")
        if position is None:
            raise ProtocolError(
                "the controller reports work positions (WPos)", hint="add 1 to $10", **self._conversation.where
            )
        pins = report.fields.get("Pn", "")
        return TrackedStatus(
            word=report.state if report.substate is None else f"{report.state}:{report.substate}",
            state=_motion_state(report),
            position_mm=np.array(position),
            deflected="P" in pins,
            permissions=self._permissions(report, pins),
            alarm=self._alarm,
            overrides=self._overrides,
            homes=self._homing_known,
        )

    def _note_restart(self, *, expected: bool) -> None:
        if self._conversation.restarts == self._restarts:
            return
        self._restarts = self._conversation.restarts
        self._offset, self._overrides, self._spindle_turns = None, (100, 100), False
        if expected:
            return
        self.unexpected_restarts += 1
        if not self._settings.homes:
            self.position_lost = True  # after power-up, it counts from its present position

    def _note_fields(self, report: StatusReport) -> None:
        self._offset = report.triple("WCO") or self._offset
        fields = report.fields
        overrides, speeds = report.pair("Ov"), report.pair("FS")
        if overrides is not None:
            self._overrides = (round(overrides[0]), round(overrides[1]))
            self._spindle_turns = bool(set("SC") & set(fields.get("A", "")))
        if speeds is not None:
            self._spindle_turns = self._spindle_turns or speeds[1] > 0.0
        if "H" in fields:
            self._homed = fields["H"].startswith("1")

    def _note_alarm(self, report: StatusReport) -> None:
        if report.state != "Alarm":
            self._conversation.clear_alarm()
            self._alarm, self._in_alarm = None, False
            return
        code = self._conversation.alarm
        if code is None and not self._in_alarm:
            code = report.substate if report.substate else self._alarm
        self._alarm = code if code is not None else self._alarm
        self._in_alarm = True
        if self._alarm not in POSITION_KEPT:
            self.position_lost = True

    def _permissions(self, report: StatusReport, pins: str) -> dict[Permission, bool]:
        state = report.state
        referenced = self._homing_known and not self.position_lost and self._homed is not False
        return {
            Permission.AUTOMATIC: state not in NOT_AUTOMATIC,
            Permission.DOORS_CLOSED: (state != "Door" or report.substate == 0) and "D" not in pins,
            Permission.SPINDLE_STOPPED: not self._spindle_turns,
            Permission.PROGRAM_IDLE: state in NO_PART_PROGRAM or self.own_motion,
            Permission.REFERENCED: referenced,
            Permission.NO_FAULT: state != "Alarm",
            Permission.CONSENT: True,
        }


def _motion_state(report: StatusReport) -> MotionState:
    match report.state, report.substate:
        case ("Run" | "Jog" | "Home", _) | ("Hold", 1) | ("Door", 2 | 3):
            return MotionState.MOVING
        case ("Hold" | "Door" | "Tool", _):
            return MotionState.HELD
        case ("Alarm", _):
            return MotionState.FAULT
    return MotionState.IDLE


def _tool_offset(message: MessageLine) -> Triple:
    """Return the tool offset: GRBL sends only a length along Z, grblHAL sends all three components."""
    return message.triple() if "," in message.text else (0.0, 0.0, message.number())
