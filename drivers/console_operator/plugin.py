"""Entry point `console-operator`: questions on stderr, answers from stdin, so stdout stays for results."""

from __future__ import annotations

import sys
from typing import TextIO

from pydantic import BaseModel, ConfigDict, Field

from drivers.errors import PermissionMissing
from drivers.registry import DeviceContext, DriverPlugin
from drivers.roles import DiagnosticFinding, OperatorRequest, OperatorTask

_CHOICES = {
    OperatorTask.MOVE_ARTEFACT: "[d]one / [n]o",
    OperatorTask.CONSENT: "[y]es / [n]o",
}
_AGREES = {"d", "done", "y", "yes"}
_DECLINES = {"n", "no"}


class ConsoleOperatorSettings(BaseModel):
    """Settings of driver `console-operator`."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    attempts: int = Field(default=5, ge=1, le=100, description="answers that are not understood before it is a no")


class ConsoleOperator:
    """Plays Operator. Refuses where nobody could answer, instead of waiting for ever."""

    def __init__(self, settings: ConsoleOperatorSettings, name: str, source: TextIO, sink: TextIO) -> None:
        self._attempts = settings.attempts
        self._name = name
        self._source = source
        self._sink = sink

    def open(self) -> None:
        """Nothing to connect; whether a terminal is there is asked when it is needed."""

    def close(self) -> None:
        """Nothing to close: the terminal belongs to whoever started volcal."""

    def stop(self) -> None:
        """Nothing moves."""

    def diagnose(self) -> list[DiagnosticFinding]:
        present = self._has_terminal
        return [DiagnosticFinding("terminal", ok=present, text="present" if present else "stdin is not a terminal")]

    def ask(self, request: OperatorRequest) -> bool:
        """True for done or yes. Raises PermissionMissing without a terminal or when it is closed meanwhile."""
        if not self._has_terminal:
            raise self._nobody(request, "no terminal to ask on")
        place = f" (station {request.station})" if request.station is not None else ""
        question = f"\n{request.text}{place} {_CHOICES[request.task]}: "
        for _ in range(self._attempts):
            answer = self._answer(request, question)
            if answer in _AGREES:
                return True
            if answer in _DECLINES:
                return False
        return False

    def _answer(self, request: OperatorRequest, question: str) -> str:
        self._sink.write(question)
        self._sink.flush()
        line = self._source.readline()
        if not line:
            raise self._nobody(request, "the terminal was closed")
        return line.strip().lower()

    @property
    def _has_terminal(self) -> bool:
        return self._source.isatty() and self._sink.isatty()

    def _nobody(self, request: OperatorRequest, why: str) -> PermissionMissing:
        return PermissionMissing(
            f"operator cannot be asked to {request.task.value}: {why}"
            if request.task is OperatorTask.MOVE_ARTEFACT
            else f"operator cannot be asked for {request.task.value}: {why}",
            hint="run volcal in a terminal, or configure another operator device",
            device=self._name,
        )


def create(settings: ConsoleOperatorSettings, context: DeviceContext) -> ConsoleOperator:
    return ConsoleOperator(settings, context.name, sys.stdin, sys.stderr)


PLUGIN = DriverPlugin("console-operator", ConsoleOperatorSettings, create)
