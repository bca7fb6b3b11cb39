"""Machine simulator that runs as a separate process, and requests to its control channel, a separate connection that
answers questions about the simulated machine.

This module starts `volcal simulate` and imports no part of the simulator. The interface between the two programs
consists of the simulator's command line, one line of JSON that the simulator prints when it is ready, and the JSON
lines of the control channel.
"""

from __future__ import annotations

import json
import socket
import subprocess
import sys
from pathlib import Path
from types import TracebackType
from typing import Any, Self, TextIO

from drivers.errors import ConfigurationError, LinkLost, ProtocolError

ANY_SOCKETCAND = "socketcand:127.0.0.1:0"
"""CAN of a simulator over TCP, on any free port."""
READY_WITHIN_S = 30.0
END_WITHIN_S = 5.0


class SimulatorProcess:
    """Context manager that runs the machine simulator as a separate process.

    The simulator ends when its standard input is closed. It therefore never runs longer than the program that started
    it.
    """

    def __init__(
        self, scenario: Path, *, can: str | None, log: Path, modbus_rtu: str | None = None, grbl: bool = False
    ) -> None:
        """`can` is the channel of the CAN bus of the mounts; it is None if there is no mount. With `grbl`, the
        controller also speaks GRBL on a pseudo-terminal."""
        self._command = [
            sys.executable,
            "-m",
            "agent.cli.main",
            "simulate",
            "--config",
            str(scenario),
            *(("--modbus", "127.0.0.1:0") if modbus_rtu is None else ("--modbus-rtu", modbus_rtu)),
            *(("--serial", "any") if grbl else ()),
            *(() if can is None else ("--can", can)),
            "--control",
            "127.0.0.1:0",
            "--clock",
            "lockstep",
            "--end-with-stdin",
        ]
        self._log = log
        self._process: subprocess.Popen[str] | None = None
        self.ready: dict[str, Any] = {}

    def __enter__(self) -> Self:
        with self._opened_log() as log:
            self._process = subprocess.Popen(  # noqa: S603  our own interpreter and command
                self._command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=log, text=True
            )
        assert self._process.stdout is not None  # noqa: S101  asked for above
        line = self._process.stdout.readline()
        if not line:
            self._process.wait(END_WITHIN_S)
            said = self._log.read_text(encoding="utf-8").strip().splitlines()
            raise LinkLost(
                f"the simulator did not start: {said[-1] if said else 'it printed nothing'}", file=str(self._log)
            )
        self.ready = json.loads(line)
        return self

    def _opened_log(self) -> TextIO:
        try:
            self._log.parent.mkdir(parents=True, exist_ok=True)
            return self._log.open("w", encoding="utf-8")
        except OSError as error:
            raise ConfigurationError(
                f"the simulator's log cannot be written: {error.strerror or error}",
                hint="choose another directory for the results",
                file=str(self._log),
            ) from error

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        process = self._process
        if process is None:
            return
        for stream in (process.stdin, process.stdout):
            if stream is not None:
                stream.close()
        try:
            process.wait(END_WITHIN_S)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()

    def ask(self, request: str, **keys: Any) -> dict[str, Any]:
        """Send the request ``truth`` (the true errors), ``collisions`` (their number), ``status`` or that of a
        measuring instrument, with its other `keys`, to the simulator's control channel, and return the answer.

        Raises LinkLost if the control channel can no longer be used, and ProtocolError if the simulator refuses the
        request.
        """
        place = self.ready["control"]
        try:
            with socket.create_connection((place["host"], place["port"]), timeout=READY_WITHIN_S) as link:
                link.sendall(json.dumps({"do": request, **keys}).encode() + b"\n")
                with link.makefile("r", encoding="utf-8") as answers:
                    answer: dict[str, Any] = json.loads(answers.readline())
        except (OSError, ValueError) as error:
            raise LinkLost(f"the simulator's control channel is gone: {error}", link="control") from error
        if "error" in answer:
            raise ProtocolError(f"the simulator refused {request!r}: {answer['error']}", link="control")
        return answer
