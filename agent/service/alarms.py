"""A stable number for every class of the one error tree, so that a panel can show its own text for it.

The numbers are a contract (docs/reference/alarms.md): a class keeps its number for ever, a number is never used twice.
Hundreds follow the branches of the tree. An error that is more special than anything listed has its parent's number.
"""

from __future__ import annotations

from dataclasses import dataclass
from types import MappingProxyType
from typing import Final

from agent import errors as run_errors
from agent.service.control import Alarm
from drivers import errors


@dataclass(frozen=True)
class AlarmCode:
    """`text`: what it means, `hint`: what a person does where the error itself says nothing better."""

    code: int
    text: str
    hint: str


DEFECT: Final = AlarmCode(900, "the program itself failed", "save the diagnostics and report it; reset, then run again")

_CODES: dict[type[errors.VolcalError], AlarmCode] = {
    errors.VolcalError: AlarmCode(100, "an error without a class of its own", "read the text of the alarm"),
    errors.UserError: AlarmCode(200, "something that was entered is wrong", "correct it and start again"),
    errors.ConfigurationError: AlarmCode(
        201, "settings, machine, artefact or link description are wrong", "correct the file and key that are named"
    ),
    errors.InputError: AlarmCode(202, "a data file or a table is wrong", "correct the file and row that are named"),
    errors.DeviceError: AlarmCode(300, "a device or a link failed", "look at the device that is named"),
    errors.LinkError: AlarmCode(310, "a link failed", "check cable, address and power of the device that is named"),
    errors.LinkLost: AlarmCode(
        311, "the connection to a device is gone", "check cable, address and power; reset, then resume the run"
    ),
    errors.LinkTimeout: AlarmCode(
        312, "a device does not answer", "check that its program runs; reset, then resume the run"
    ),
    errors.ProtocolError: AlarmCode(
        313, "a device answered what its protocol does not allow", "check its program and register map"
    ),
    errors.CommandRejected: AlarmCode(320, "a device refused a command", "read the fault on the device that is named"),
    errors.MotionFault: AlarmCode(
        330, "motion ended in a fault", "clear limit, emergency stop or servo fault at the machine; reset"
    ),
    errors.GuardTripped: AlarmCode(
        331, "the probe touched something in a move that was no touch", "clear the way and check the stylus; reset"
    ),
    errors.DeadlineExpired: AlarmCode(
        340, "a device did not get there in time", "see whether it is held, blocked or overridden to zero; reset"
    ),
    errors.PermissionMissing: AlarmCode(
        350, "the machine gives no permission", "door, automatic mode, spindle, probe: set what is named"
    ),
    errors.StoreError: AlarmCode(
        360, "the compensation table could not be handled", "see which table is active before the next part"
    ),
    errors.ChecksumMismatch: AlarmCode(
        361, "the checksum of a compensation table is wrong", "see which table is active; restore a backup"
    ),
    errors.ReadBackMismatch: AlarmCode(
        362, "the controller read back another table than was written", "see which table is active; restore a backup"
    ),
    errors.NotActiveYet: AlarmCode(
        363, "a compensation table is written and waits for the controller", "do what is named, then resume the run"
    ),
    run_errors.RunError: AlarmCode(400, "the run ended itself", "read the text of the alarm"),
    run_errors.PlanRefused: AlarmCode(
        410, "the plan would hit a limit or an obstacle", "move the mount or choose another position set"
    ),
    run_errors.GateRefused: AlarmCode(
        420, "the estimate is not good enough to become a table", "the old table stays; read the gate that is named"
    ),
    run_errors.MeasurementFault: AlarmCode(
        430, "a measurement is out of its limits", "clean balls and stylus, check clamping and temperature"
    ),
    run_errors.PlanDiverged: AlarmCode(
        440, "the recorded run does not fit the settings", "restore the settings of that run or start anew"
    ),
    run_errors.JournalFailed: AlarmCode(
        450, "what happens can no longer be recorded", "make room on the disk or replace it; reset"
    ),
    run_errors.Busy: AlarmCode(460, "another run owns the machine", "wait for its end or abort it"),
    run_errors.Aborted: AlarmCode(470, "somebody aborted the run", "reset when the machine is clear"),
    run_errors.Interrupted: AlarmCode(
        480, "the run was broken off from outside", "look at the machine; reset, then resume the run"
    ),
}
CODES: Final = MappingProxyType(_CODES)


def alarm_code(error: BaseException) -> AlarmCode:
    """Of the error's class or of the nearest one above it; DEFECT for what is not of the tree."""
    for kind in type(error).__mro__:
        if kind in CODES:
            return CODES[kind]
    return DEFECT


def alarm_of(error: BaseException) -> Alarm:
    """The error as an alarm: its own text, hint and places; the table's hint where it has none."""
    found = alarm_code(error)
    if isinstance(error, errors.VolcalError):
        return Alarm(found.code, error.message, error.hint or found.hint, MappingProxyType(dict(error.where)))
    return Alarm(found.code, f"{found.text}: {type(error).__name__}: {error}", found.hint)
