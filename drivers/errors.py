"""Error classes: the base class `VolcalError`, errors in user input, and errors of devices and links.

::

    VolcalError
    ├── UserError                 wrong input: a file, a key, a row, an argument      exit code 2
    │   ├── ConfigurationError    settings, machine, artefact or link description
    │   └── InputError            measured data, tables, grids
    └── DeviceError               something on a link or in a device went wrong       exit code 3
        ├── LinkError
        │   ├── LinkLost          connection refused, reset, heartbeat gone
        │   ├── LinkTimeout       the peer is connected but does not answer
        │   └── ProtocolError     an answer that the protocol does not allow
        ├── CommandRejected       the device understood and refused
        ├── MotionFault           motion ended in a fault (limit, following error, e-stop)
        │   └── GuardTripped      the probe tripped in a move that was not a touch
        ├── DeadlineExpired       the device did not reach the awaited state in time
        ├── PermissionMissing     door open, not in automatic, spindle turning, no probe ...
        └── StoreError            compensation tables
            ├── ChecksumMismatch
            ├── ReadBackMismatch
            └── NotActiveYet      the table is written, but the controller activates it only later

The application that uses the drivers adds a branch `RunError` for decisions of a run (refused, aborted, busy).

Every error says what is wrong, where, and what to do; `str()` gives all three on one line.
"""

from __future__ import annotations

from typing import ClassVar, Self


class VolcalError(Exception):
    """Base class of all errors that volcal's drivers and application raise.

    `where` maps the kind of a location (device, link, step, file, key or row) to the location itself, for example
    "file" to a path. `hint` tells the user what to do.
    """

    exit_code: ClassVar[int] = 1

    def __init__(self, message: str, *, hint: str = "", **where: str | int) -> None:
        super().__init__(message)
        self.message = message
        self.hint = hint
        self.where: dict[str, str] = {name: str(value) for name, value in where.items()}

    def at(self, **where: str | int) -> Self:
        """Add locations that a caller knows, such as a step key or a device name, and return this error.

        Locations that the error already has are kept.
        """
        for name, value in where.items():
            self.where.setdefault(name, str(value))
        return self

    def __str__(self) -> str:
        places = ", ".join(f"{name} {value}" for name, value in self.where.items())
        text = f"{self.message} ({places})" if places else self.message
        return f"{text}. {self.hint}" if self.hint else text


class UserError(VolcalError):
    exit_code = 2


class ConfigurationError(UserError):
    pass


class InputError(UserError):
    pass


class DeviceError(VolcalError):
    exit_code = 3


class LinkError(DeviceError):
    pass


class LinkLost(LinkError):
    pass


class LinkTimeout(LinkError):
    pass


class ProtocolError(LinkError):
    pass


class CommandRejected(DeviceError):
    pass


class MotionFault(DeviceError):
    pass


class GuardTripped(MotionFault):
    pass


class DeadlineExpired(DeviceError):
    pass


class PermissionMissing(DeviceError):
    pass


class StoreError(DeviceError):
    pass


class ChecksumMismatch(StoreError):
    pass


class ReadBackMismatch(StoreError):
    pass


class NotActiveYet(StoreError):
    pass
