"""The one error tree.

::

    VolcalError
    ├── UserError                 wrong input: a file, a key, a row, an argument      exit code 2
    │   ├── ConfigurationError    settings, machine, artefact or link description
    │   └── InputError            measured data, tables, grids
    ├── DeviceError               something on a link or in a device went wrong       exit code 3
    │   ├── LinkError
    │   │   ├── LinkLost          connection refused, reset, heartbeat gone
    │   │   ├── LinkTimeout       the peer is there and does not answer
    │   │   └── ProtocolError     an answer that the protocol does not allow
    │   ├── CommandRejected       the device understood and refused
    │   ├── MotionFault           motion ended in a fault (limit, following error, e-stop)
    │   │   └── GuardTripped      the probe tripped in a move that was no touch
    │   ├── DeadlineExpired       the device did not reach the awaited state in time
    │   ├── PermissionMissing     door open, not in automatic, spindle turning, no probe ...
    │   └── StoreError            compensation tables
    │       ├── ChecksumMismatch
    │       ├── ReadBackMismatch
    │       └── NotActiveYet      written, and the controller makes it act only later
    └── RunError                  the run itself decided                              exit code 4
        ├── PlanRefused           preflight found a limit, a collision, an unreachable ball
        ├── GateRefused           the estimate must not become a table
        ├── MeasurementFault      a ball, a probe check or a drift is out of its limits
        ├── PlanDiverged          recorded steps do not fit the rebuilt plan
        ├── JournalFailed         what happens can no longer be made durable (disk full, disk gone)
        ├── Busy                  another run owns the machine
        ├── Aborted               somebody asked for it                               exit code 5
        └── Interrupted           the program had to end; the run can be gone on with exit code 5

Every error says what is wrong, where, and what to do; `str()` gives all three on one line.
"""

from __future__ import annotations

from typing import ClassVar, Self


class VolcalError(Exception):
    """Root of the tree. `where` holds named places (device, link, step, file, key, row), `hint` what to do."""

    exit_code: ClassVar[int] = 1

    def __init__(self, message: str, *, hint: str = "", **where: str | int) -> None:
        super().__init__(message)
        self.message = message
        self.hint = hint
        self.where: dict[str, str] = {name: str(value) for name, value in where.items()}

    def at(self, **where: str | int) -> Self:
        """Add places known further up (a step key, a device name); what is already named stays."""
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


class RunError(VolcalError):
    exit_code = 4


class PlanRefused(RunError):
    pass


class GateRefused(RunError):
    pass


class MeasurementFault(RunError):
    pass


class PlanDiverged(RunError):
    pass


class JournalFailed(RunError):
    pass


class Busy(RunError):
    pass


class Aborted(RunError):
    exit_code = 5


class Interrupted(RunError):
    exit_code = 5
