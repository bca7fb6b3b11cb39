"""Control of an unmodified LinuxCNC without a screen: start, switch on, home and stop."""

from __future__ import annotations

import os
import socket
import subprocess
from pathlib import Path
from types import TracebackType
from typing import Self

from drivers.clock import Deadline, RealClock
from drivers.errors import ConfigurationError, LinkLost
from simulators.linuxcnc.namespaces import HOME

RSH_PORT = 5007
START_TIMEOUT_S = 30.0
STOP_TIMEOUT_S = 20.0
POLL_S = 0.05
NOBODY = "65534"
JOINTS = 3


class LinuxCncInstance:
    """Context manager for a running LinuxCNC.

    `speed` is the number of seconds that pass in the controller per second of wall time. `directory` holds the
    configuration (INI file and files of the hardware abstraction layer, HAL) and receives the log. Programs that the
    HAL files load are searched for in the directory `programs` first.
    """

    def __init__(self, directory: Path, ini: str, *, speed: float, programs: Path) -> None:
        self._directory = directory
        self._ini = directory / ini
        self._speed = speed
        self._programs = programs
        self._process: subprocess.Popen[bytes] | None = None

    def __enter__(self) -> Self:
        command = ["linuxcnc", str(self._ini)]
        if self._speed != 1.0:
            command = ["faketime", "-f", f"+0 x{self._speed:g}", *command]
        with self.log.open("wb") as log:
            self._process = subprocess.Popen(  # noqa: S603  programs of the distribution
                command, stdin=subprocess.DEVNULL, stdout=log, stderr=log, cwd=self._directory, env=self._environment()
            )
        try:
            self._make_ready()
        except BaseException:
            self._kill()
            raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            with self._send("shutdown"):
                if self._process is not None:
                    self._process.wait(STOP_TIMEOUT_S)
        except (OSError, subprocess.TimeoutExpired):
            self._kill()

    @property
    def log(self) -> Path:
        return self._directory / "linuxcnc.log"

    def _environment(self) -> dict[str, str]:
        path = f"{self._programs}:{os.environ.get('PATH', '')}"
        fifo = "/tmp/rtapi_fifo"  # noqa: S108  inside the namespace
        return os.environ | {"HOME": HOME, "PATH": path, "RTAPI_UID": NOBODY, "RTAPI_FIFO_PATH": fifo}

    def _make_ready(self) -> None:
        """Wait for the server of LinuxCNC's display program (linuxcncrsh), release the emergency stop, switch on and
        home.
        """
        deadline = Deadline.after(RealClock(), START_TIMEOUT_S)
        while not self._homed():
            if self._process is not None and self._process.poll() is not None:
                output = self.log.read_text(encoding="utf-8", errors="replace").strip().splitlines()
                raise ConfigurationError(
                    f"LinuxCNC did not start: {output[-1] if output else 'no output'}", file=str(self.log)
                )
            deadline.raise_if_expired("LinuxCNC to be homed", hint=f"see {self.log}")
            deadline.clock.sleep(POLL_S)

    def _homed(self) -> bool:
        """Request the steps still missing; return True if the machine is on and homed."""
        try:
            reply = self._ask("get joint_homed", "get machine")
            if reply.count(" YES") < JOINTS:
                self._ask("set estop off", "set machine on", "set mode manual", "set home -1", "get machine")
                return False
        except OSError:
            return False
        return "MACHINE ON" in reply

    def _ask(self, *lines: str) -> str:
        """Send `lines` and then `get machine` to linuxcncrsh; return all text received up to the answer to the
        latter.
        """
        with self._send(*lines) as link:
            answer = ""
            while "MACHINE O" not in answer or not answer.endswith("\n"):
                chunk = link.recv(4096)
                if not chunk:
                    break
                answer += chunk.decode(errors="replace").upper()
        return answer

    def _send(self, *lines: str) -> socket.socket:
        text = "".join(f"{line}\r\n" for line in ("hello EMC volcal 1.0", "set enable EMCTOO", *lines))
        link = socket.create_connection(("127.0.0.1", RSH_PORT), timeout=STOP_TIMEOUT_S)
        link.sendall(text.encode())
        return link

    def _kill(self) -> None:
        if self._process is None or self._process.poll() is not None:
            return
        self._process.terminate()
        try:
            self._process.wait(STOP_TIMEOUT_S)
        except subprocess.TimeoutExpired as late:
            self._process.kill()
            raise LinkLost("LinuxCNC does not terminate", file=str(self.log)) from late
