"""Execution of panel commands. The command with a given sequence number is executed only once. Most commands require
the access code. All panels can read the result."""

from __future__ import annotations

import threading

import structlog

from agent.service.alarms import alarm_code
from agent.service.control import Control
from agent.service.gateway.access import AccessCode
from agent.service.gateway.command_block import CommandRequest, ValueNotAllowed
from agent.service.gateway.frames import ExceptionCode, RegisterError
from agent.service.gateway.registers import FREE_COMMANDS, Command, Result
from agent.service.gateway.sequence_ledger import SequenceLedger, next_sequence
from drivers.errors import InputError, VolcalError

ABORT_REASON = "abort from a panel"
log = structlog.get_logger()


class CommandHandler:
    """Command handler shared by all connections. Any thread may submit commands. They are executed one at a time,
    except that `abort` takes effect immediately."""

    def __init__(self, control: Control, ledger: SequenceLedger, access: AccessCode) -> None:
        self._control = control
        self._ledger = ledger
        self._access = access
        self._lock = threading.Lock()
        self._state: tuple[int, int] = (ledger.accepted, Result.NONE)
        self._latest_start: str | None = None

    @property
    def latest_start(self) -> str | None:
        """Identity of the run that a panel started or resumed last."""
        return self._latest_start

    def state(self) -> tuple[int, int]:
        """Return the sequence number and the result code of the last completed command."""
        return self._state

    def abort(self) -> None:
        log.info("abort from a panel")
        self._control.abort(ABORT_REASON)

    def submit(self, request: CommandRequest) -> None:
        """Execute a command whose sequence number follows that of the last accepted command, and store its result.

        If the response was lost, a panel repeats its last command; this repetition has no effect. Raise RegisterError
        without executing anything if the command has any other sequence number, or if the number cannot be recorded. A
        command that only stops the machine is executed even if its number cannot be recorded.
        """
        with self._lock:
            if request.sequence == self._ledger.accepted and request.content == self._ledger.content:
                return
            if request.sequence != next_sequence(self._ledger.accepted):
                raise RegisterError(ExceptionCode.VALUE)
            self._record(request)
            result = self._perform(request)
            self._state = (request.sequence, result)
            log.info("command from a panel", sequence=request.sequence, command=request.command(), result=result)

    def _record(self, request: CommandRequest) -> None:
        try:
            self._ledger.record(request.sequence, request.content)
        except InputError as error:
            if request.command() not in FREE_COMMANDS:
                log.error("command from a panel not accepted", reason=str(error))
                raise RegisterError(ExceptionCode.FAILURE) from error
            # A full disk must not keep the machine moving. If the service restarts before a later number is stored,
            # this one is valid once more: a repetition then stops the machine again.
            log.error("number of a command from a panel not recorded", reason=str(error))
            self._ledger.keep(request.sequence, request.content)

    def _perform(self, request: CommandRequest) -> int:
        command = request.command()
        if command is None:
            return Result.UNKNOWN_COMMAND
        if command not in FREE_COMMANDS and (refusal := self._refusal(request.access_code)):
            return refusal
        try:
            self._carry_out(command, request)
        except ValueNotAllowed as error:
            log.info("command from a panel refused", reason=str(error))
            return Result.VALUE_NOT_ALLOWED
        except VolcalError as error:
            log.info("command from a panel refused", reason=str(error))
            return alarm_code(error).code
        except Exception as error:
            log.exception("command from a panel failed")
            return alarm_code(error).code
        return Result.DONE

    def _refusal(self, code: int) -> Result | None:
        if not self._access.is_set:
            return Result.NO_CODE_SET
        if self._access.locked:
            return Result.LOCKED
        if not self._access.fits(code):
            log.warning("wrong access code from a panel")
            return Result.WRONG_CODE
        return None

    def _carry_out(self, command: Command, request: CommandRequest) -> None:
        control = self._control
        if command is Command.START:
            self._latest_start = control.start(request.run_request())
        elif command is Command.RESUME_RUN:
            self._latest_start = control.resume_run("panel")
        elif command is Command.ANSWER:
            control.answer(*request.answer())
        elif command is Command.ABORT:
            self.abort()
        elif command is Command.HOLD:
            control.hold()
        elif command is Command.RESUME:
            control.resume()
        elif command is Command.RESET:
            control.reset()
