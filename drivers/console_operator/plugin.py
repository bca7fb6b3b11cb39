"""Driver plugin `console-operator`, which asks an operator in a terminal.

Questions to the operator are written to stderr and answers are read from stdin, so stdout remains free for results.
What was typed before a question was shown is discarded: it is not the answer to it. While a question is open, the
device waits with the clock of the run, so that the run can be held or ended.
"""

from __future__ import annotations

import select
import sys
import termios
from typing import TextIO

from pydantic import Field

from drivers.clock import Clock
from drivers.errors import PermissionMissing
from drivers.options import DriverOptions
from drivers.registry import DeviceContext, DriverPlugin
from drivers.roles import DiagnosticFinding, OperatorRequest, OperatorTask

_CHOICES = {
    OperatorTask.MOVE_ARTEFACT: "[d]one / [n]o",
    OperatorTask.PLACE_ARTEFACT: "[d]one / [n]o",
    OperatorTask.CONSENT: "[y]es / [n]o",
}
_POLL_S = 0.1
"""Interval in s of looking for an answer, first on the wall clock and then on that of the run, which a simulator may
advance as fast as it can."""
_AGREES = {"d", "done", "y", "yes"}
_DECLINES = {"n", "no"}


class ConsoleOperatorSettings(DriverOptions):
    """Settings of the driver `console-operator`."""

    attempts: int = Field(default=5, ge=1, le=100, description="unrecognised answers until the reply counts as no")


class ConsoleOperator:
    """Operator at a terminal. If there is no terminal, `ask` raises an error immediately."""

    def __init__(
        self, settings: ConsoleOperatorSettings, name: str, clock: Clock, source: TextIO, sink: TextIO
    ) -> None:
        self._attempts = settings.attempts
        self._name = name
        self._clock = clock
        self._source = source
        self._sink = sink

    def open(self) -> None:
        """Do nothing, because a terminal needs no connection.

        The terminal is checked when a question is asked.
        """

    def close(self) -> None:
        """Do nothing: the terminal belongs to the process that started volcal."""

    def stop(self) -> None:
        """Do nothing: this device moves nothing."""

    def diagnose(self) -> list[DiagnosticFinding]:
        present = self._has_terminal
        return [DiagnosticFinding("terminal", ok=present, text="present" if present else "stdin is not a terminal")]

    def ask(self, request: OperatorRequest) -> bool:
        """Ask a question, and return True if the operator answers "done" or "yes".

        Return False if the operator answers "no" or gives too many answers that are not recognised. Raises
        PermissionMissing if there is no terminal, or if the terminal is closed before the answer.
        """
        if not self._has_terminal:
            raise self._unreachable(request, "there is no terminal")
        place = f" (station {request.station})" if request.station is not None else ""
        # A display of progress shows complete lines only, and takes brackets at the end for markup.
        question = f"\n{request.text}{place}\n{_CHOICES[request.task]}:\n"
        for _ in range(self._attempts):
            answer = self._answer(request, question)
            if answer in _AGREES:
                return True
            if answer in _DECLINES:
                return False
        return False

    def _answer(self, request: OperatorRequest, question: str) -> str:
        """Return what the operator types after the question was shown; an empty text if it is not text at all."""
        try:
            termios.tcflush(self._source, termios.TCIFLUSH)
            self._sink.write(question)
            self._sink.flush()
            while not select.select([self._source], [], [], _POLL_S)[0]:
                self._clock.sleep(_POLL_S)
            line = self._source.readline()
        except UnicodeDecodeError:
            return ""
        except (OSError, termios.error) as error:
            raise self._unreachable(request, "the terminal was closed") from error
        if not line:
            raise self._unreachable(request, "the terminal was closed")
        return line.strip().lower()

    @property
    def _has_terminal(self) -> bool:
        return self._source.isatty() and self._sink.isatty()

    def _unreachable(self, request: OperatorRequest, why: str) -> PermissionMissing:
        return PermissionMissing(
            f"the operator cannot be asked to {request.task.value}: {why}"
            if request.task is not OperatorTask.CONSENT
            else f"the operator cannot be asked for {request.task.value}: {why}",
            hint="run volcal in a terminal, or configure another operator device",
            device=self._name,
        )


def create(settings: ConsoleOperatorSettings, context: DeviceContext) -> ConsoleOperator:
    return ConsoleOperator(settings, context.name, context.clock, sys.stdin, sys.stderr)


PLUGIN = DriverPlugin("console-operator", ConsoleOperatorSettings, create)
