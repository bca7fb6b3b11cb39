"""Stable alarm number of each error class. A panel can use the number to select its own alarm text.

The numbers are a contract (docs/reference/alarms.md): a class keeps its number, and a number is never reused. Each
branch of the class hierarchy has a range of one hundred numbers. An error class without a number of its own has the
number of its parent class.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, Final

from agent import errors as run_errors
from agent.service.control import Alarm
from drivers import errors


@dataclass(frozen=True)
class AlarmCode:
    """Alarm number, its meaning (`text`) and a general `hint`. The general hint is shown if the error itself has no
    hint."""

    code: int
    text: str
    hint: str


DEFECT: Final = AlarmCode(
    900, "internal error of the program", "save the diagnostics and report the error; reset, then start again"
)

_CODES: dict[type[errors.VolcalError], AlarmCode] = {
    errors.VolcalError: AlarmCode(100, "unclassified error", "see the alarm text"),
    errors.UserError: AlarmCode(200, "invalid entry", "correct the entry and start again"),
    errors.ConfigurationError: AlarmCode(
        201, "invalid settings, machine, artefact or link description", "correct the file and key given in the alarm"
    ),
    errors.InputError: AlarmCode(202, "invalid data file or table", "correct the file and row given in the alarm"),
    run_errors.EndpointUnavailable: AlarmCode(
        203,
        "an endpoint of the service cannot be opened",
        "correct the file given in the alarm and restart the service",
    ),
    run_errors.NotAllowedInState: AlarmCode(
        210, "the request is not allowed in this state", "see which requests the state allows"
    ),
    errors.DeviceError: AlarmCode(300, "device or link failed", "check the device given in the alarm"),
    errors.LinkError: AlarmCode(310, "link failed", "check cable, address and power supply of the device"),
    errors.LinkLost: AlarmCode(
        311, "connection to a device lost", "check cable, address and power supply; reset, then resume the run"
    ),
    errors.LinkTimeout: AlarmCode(
        312, "device does not respond", "check that its program is running; reset, then resume the run"
    ),
    errors.ProtocolError: AlarmCode(
        313, "invalid response from a device", "check the program and the register map of the device"
    ),
    errors.CommandRejected: AlarmCode(320, "device rejected a command", "read the fault on the device"),
    errors.MotionFault: AlarmCode(
        330, "motion fault", "clear the limit, emergency stop or servo fault at the machine; reset"
    ),
    errors.GuardTripped: AlarmCode(
        331, "the probe was deflected in a move that was not a touch", "clear the path and check the stylus; reset"
    ),
    errors.DeadlineExpired: AlarmCode(
        340, "device did not reach its target in time", "check for feed hold, obstruction or zero override; reset"
    ),
    errors.PermissionMissing: AlarmCode(
        350,
        "machine not released for motion",
        "establish the missing condition: door, automatic mode, spindle or probe",
    ),
    run_errors.ResetMissing: AlarmCode(
        351, "the end of the last run is not acknowledged", "remove the cause of its alarm; reset, then start again"
    ),
    errors.StoreError: AlarmCode(
        360, "compensation table error", "check which table is active before machining the next part"
    ),
    errors.ChecksumMismatch: AlarmCode(
        361, "checksum of a compensation table does not match", "check which table is active; restore a backup"
    ),
    errors.ReadBackMismatch: AlarmCode(
        362, "table read back differs from the table written", "check which table is active; restore a backup"
    ),
    errors.NotActiveYet: AlarmCode(
        363, "compensation table written, not active yet", "follow the instruction, then resume the run"
    ),
    run_errors.RunError: AlarmCode(400, "the run ended with an error", "see the alarm text"),
    run_errors.PlanRefused: AlarmCode(
        410, "the planned path violates a limit or an obstacle", "move the mount or choose another position set"
    ),
    run_errors.GateRefused: AlarmCode(
        420,
        "refused by a condition for acceptance or start",
        "nothing was written, the compensation is as it was; see the alarm text",
    ),
    run_errors.ForecastRefused: AlarmCode(
        421, "an acceptance gate is expected to refuse the run", "change the settings key given in the alarm"
    ),
    run_errors.MeasurementFault: AlarmCode(
        430, "measurement outside its limits", "clean the balls and the stylus; check clamping and temperature"
    ),
    run_errors.ArtefactMoved: AlarmCode(
        431,
        "the artefact has moved during an interruption",
        "check the clamping of artefact and mount; resume the run: the position is measured again",
    ),
    run_errors.PlacementLost: AlarmCode(
        432,
        "an artefact placed by hand no longer stands where it was found",
        "clean the ball and check that the artefact stands firmly; resume the run",
    ),
    run_errors.ThermometerFault: AlarmCode(
        433,
        "a thermometer fails, or its reading has jumped",
        "check the thermometer and its contact with the artefact; resume the run",
    ),
    run_errors.PlanDiverged: AlarmCode(
        440, "the recorded run does not match the settings", "restore the settings of that run or start a new run"
    ),
    run_errors.JournalFailed: AlarmCode(
        450, "the journal cannot be written", "free disk space or replace the disk; reset"
    ),
    run_errors.Busy: AlarmCode(460, "another run is in progress", "wait until it ends or abort it"),
    run_errors.Aborted: AlarmCode(470, "the run was aborted", "reset when the machine is clear"),
    run_errors.Interrupted: AlarmCode(
        480, "the run was interrupted externally", "check the machine; reset, then resume the run"
    ),
}
CODES: Final = MappingProxyType(_CODES)


def alarm_code(error: BaseException) -> AlarmCode:
    """Return the alarm code of the error's class or, if this class has no code, of its nearest base class that has one.

    If neither the class nor any base class has a code, return `DEFECT`, the code for an internal error of the program.
    """
    for kind in type(error).__mro__:
        if kind in CODES:
            return CODES[kind]
    return DEFECT


def code_of_name(name: str, unknown: AlarmCode) -> AlarmCode:
    """Return the alarm code of the error class that is called `name`, or `unknown` if no class with a number has this
    name."""
    return next((code for kind, code in CODES.items() if kind.__name__ == name), unknown)


def alarm_of(error: BaseException) -> Alarm:
    """Return an alarm with the text, the location and the hint of the error. If the error has no hint, use the general
    hint of its alarm code, or that of a wrong entry if the error names no file."""
    found = alarm_code(error)
    if isinstance(error, errors.VolcalError):
        of_file = not isinstance(error, errors.InputError) or "file" in error.where
        general = found if of_file else CODES[errors.UserError]
        return Alarm(found.code, error.message, error.hint or general.hint, MappingProxyType(dict(error.where)))
    return Alarm(found.code, found.text, found.hint)


def recorded_alarm(record: Mapping[str, Any]) -> Alarm | None:
    """Return the alarm that the service has recorded in the journal as `record`, or None if the record is damaged or of
    another version of volcal."""
    try:
        where = {str(place): str(found) for place, found in record["where"].items()}
        return Alarm(int(record["code"]), str(record["text"]), str(record["hint"]), where)
    except (AttributeError, KeyError, TypeError, ValueError, errors.InputError):
        return None


def journaled_alarm(record: Mapping[str, Any], unknown: AlarmCode) -> Alarm:
    """Return the alarm for an error that a run has journaled as `record`. If its class has no number, the alarm has
    that of `unknown`."""
    found = code_of_name(str(record.get("type", "")), unknown)
    step = record.get("step")
    return Alarm(
        found.code, str(record.get("error", "")) or found.text, found.hint, {"step": str(step)} if step else {}
    )
