"""Run of `python -m simulators.linuxcnc` as a separate process, for tests and benchmarks outside its namespaces."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from drivers.errors import LinkLost
from simulators.linuxcnc.namespaces import nsenter_command

END_WITHIN_S = 30.0
ANSWER_WITHIN_S = 600.0
_ASK = "import socket, sys; s = socket.create_connection((sys.argv[1], int(sys.argv[2])), 30); " + (
    "s.sendall(sys.argv[3].encode() + b'\\n'); print(s.makefile().readline())"
)
"""Program, run inside the network namespace, that sends one request to the control channel."""


class LinuxCncProcess:
    """Context manager that runs LinuxCNC and the simulated plant around it in a separate process, and ends both on
    exit.
    """

    def __init__(
        self,
        *,
        scenario: Path,
        configuration: Path,
        components: Path,
        work: Path,
        speed: float,
        ini: str = "machine.ini",
    ) -> None:
        self.work = work
        self._arguments = [
            *("--scenario", str(scenario), "--configuration", str(configuration), "--components", str(components)),
            *("--work", str(work), "--speed", f"{speed:g}", "--ini", ini),
        ]
        self._process: subprocess.Popen[str] | None = None
        self.ready: dict[str, Any] = {}

    def __enter__(self) -> Self:
        command = [sys.executable, "-m", "simulators.linuxcnc", *self._arguments]
        self._process = subprocess.Popen(  # noqa: S603  our own program
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )
        assert self._process.stdout is not None  # noqa: S101  a pipe was requested above
        line = self._process.stdout.readline()
        if not line:
            self.__exit__(None, None, None)
            raise LinkLost(
                "LinuxCNC did not start", hint="see the reason printed above", file=str(self.work / "linuxcnc.log")
            )
        self.ready = json.loads(line)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._process is None:
            return
        try:
            self._process.communicate(timeout=END_WITHIN_S)  # closing its standard input ends it
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.communicate()

    def inside(self, *command: str) -> list[str]:
        """Return a command line that runs `command` in the namespaces of this LinuxCNC."""
        return [*nsenter_command(self.ready["pid"]), *command]

    @property
    def bridge_command(self) -> list[str]:
        """Value for the option `bridge_command` of the LinuxCNC driver, if the driver runs outside the namespaces."""
        return self.inside("/usr/bin/python3")

    def ask(self, request: str) -> dict[str, Any]:
        """Send one request (``truth``, ``collisions`` or ``status``) to the control channel, and return the answer."""
        place = self.ready["control"]
        words = self.inside("/usr/bin/python3", "-c", _ASK, place["host"], str(place["port"]))
        done = subprocess.run(  # noqa: S603  our own program
            [*words, json.dumps({"do": request})],
            capture_output=True,
            text=True,
            timeout=ANSWER_WITHIN_S,
            check=True,
        )
        answer: dict[str, Any] = json.loads(done.stdout)
        return answer
