"""Real calibration service as a separate process, with its settings and its clients."""

from __future__ import annotations

import os
import shutil
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from datetime import datetime
from pathlib import Path
from typing import Any, TypeVar

import httpx

from agent.planning.case_file import CASE_STUDY, SHIPPED_CONFIGURATION
from agent.service import address_file
from agent.service.allowed_requests import AT_REST
from campaigns.fortnight.simulated_calendar import set_calendar

Found = TypeVar("Found")
Document = dict[str, Any]

TIMEOUT_S = 300.0
POLL_S = 0.005
STATUS_POLL_S = 0.2
"""Interval in s between status requests; more frequent requests would slow down the run."""
AT_REST_NAMES = frozenset(state.value for state in AT_REST)
COMMAND = (sys.executable, "-m", "agent.cli.main")
SECTIONS = """
[service]
port = {port}
hours = ["22:00-05:30"]
warm_up_minutes = 30

[history]
ve_tolerance_um = 5.0
held_out_tolerance_um = 3.5
"""


def wait_for(condition: Callable[[], Found | None], what: str, every_s: float = POLL_S) -> Found:
    """Call the function `condition` repeatedly until its result is true, and return that result.

    Raises TimeoutError with the text `what` if the result does not become true in time.
    """
    ends_s = time.monotonic() + TIMEOUT_S
    while not (found := condition()):
        if time.monotonic() > ends_s:
            raise TimeoutError(f"timed out waiting for {what}")
        time.sleep(every_s)
    return found


class ServiceHost:
    """Host of the calibration service: a state directory with its settings and, most of the time, the running service.

    If the host is used as a context manager, all processes that it has started end when the context ends.
    """

    def __init__(self, directory: Path, ready: Mapping[str, Any], changes: Mapping[str, str] | None = None) -> None:
        self.directory = directory
        self._changes = changes or {}
        self.config = directory / "volcal.toml"
        self.calendar = directory / "calendar"
        self.state = directory / "state"
        self.processes: list[subprocess.Popen[str]] = []
        self._service: subprocess.Popen[str] | None = None
        self._http: httpx.Client | None = None
        directory.mkdir(parents=True, exist_ok=True)
        self.config.write_text(settings_text(ready, self._changes), encoding="utf-8")

    def __enter__(self) -> ServiceHost:
        return self

    def __exit__(self, *_: object) -> None:
        if self._http is not None:
            self._http.close()
        for process in self.processes:
            if process.poll() is None:
                process.kill()
                process.wait()

    def set_time(self, instant: datetime) -> None:
        set_calendar(self.calendar, instant)

    def copy(self, directory: Path, ready: Mapping[str, Any]) -> ServiceHost:
        """Return a new host in `directory` with a copy of this host's state.

        The settings of the new host are the same except for the machine's addresses, which are taken from `ready`, the
        addresses of a different simulated plant.
        """
        shutil.copytree(
            self.state, directory / "state", ignore=shutil.ignore_patterns(address_file.ADDRESS_FILE, "*.lock")
        )
        other = ServiceHost(directory, ready, self._changes)
        shutil.copy(self.calendar, other.calendar)
        return other

    # ------------------------------------------------------------------ the service

    def serve(self) -> None:
        """Start the service as systemd would, and wait until it answers requests."""
        arguments = ["-m", "campaigns.fortnight.serving", str(self.config), str(self.calendar)]
        with (self.directory / "service.log").open("a", encoding="utf-8") as log:
            self._service = self._start([sys.executable, *arguments], stdout=log, stderr=subprocess.STDOUT)
        (self.state / address_file.ADDRESS_FILE).unlink(missing_ok=True)  # left by a service that was killed
        wait_for(lambda: (self.state / address_file.ADDRESS_FILE).exists() or self._ended(), "the service")
        if self._ended():
            raise RuntimeError((self.directory / "service.log").read_text(encoding="utf-8")[-2000:])
        token = (self.state / "token").read_text(encoding="utf-8").strip()
        self._http = httpx.Client(base_url=address_file.read_address(self.state), timeout=60.0, trust_env=False)
        self._token = {"Authorization": f"Bearer {token}"}

    def kill_service(self) -> None:
        """Kill the service process without notice, as in a power failure."""
        assert self._service is not None
        self._service.kill()
        self._service.wait()

    def stop(self) -> int:
        """Stop the service with SIGTERM, as `systemctl stop` does, and return its exit code."""
        assert self._service is not None
        self._service.send_signal(signal.SIGTERM)
        return self._service.wait(TIMEOUT_S)

    def _ended(self) -> bool:
        return self._service is not None and self._service.poll() is not None

    @property
    def pid(self) -> int:
        """Process identity of the running service."""
        assert self._service is not None
        return self._service.pid

    # ------------------------------------------------------------------ clients

    def read(self, paths: Sequence[str]) -> None:
        """Read the `paths` to their ends, and the first event of a stream that is then dropped."""
        assert self._http is not None
        for path in paths:
            self._http.get(path).raise_for_status()
        with self._http.stream("GET", "/api/events") as stream:
            next(stream.iter_lines())

    def status(self) -> Document:
        return self.get("/api/status")

    def get(self, path: str) -> Document:
        assert self._http is not None
        answer = self._http.get(path)
        answer.raise_for_status()
        document: Document = answer.json()
        return document

    def post(self, path: str, body: Mapping[str, Any] | None = None, *, token: bool = True) -> httpx.Response:
        assert self._http is not None
        return self._http.post(path, json=body, headers=self._token if token else {})

    def at_rest(self, run_id: str) -> Document:
        """Wait until the run `run_id` has ended, and return the status of the service."""

        def ended() -> Document | None:
            now = self.status()
            return now if now["run_id"] == run_id and now["state"] in AT_REST_NAMES else None

        return wait_for(ended, f"the end of run {run_id}", STATUS_POLL_S)

    def command(self, *arguments: str, timer: bool = False) -> subprocess.Popen[str]:
        """Start the command `volcal` with `arguments` and with the settings of this host, and return its process.

        If `timer` is True, the command runs with the environment that systemd's timer gives it.
        """
        environment = {**os.environ, "OPENBLAS_NUM_THREADS": "1"}
        if timer:
            environment["INVOCATION_ID"] = "fortnight"
        command = [*COMMAND, *arguments, "--config", str(self.config)]
        return self._start(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, env=environment)

    def output(self, *arguments: str) -> str:
        """Run a `volcal` command to its end and return its standard output, whatever its exit code is."""
        return self.command(*arguments).communicate(timeout=TIMEOUT_S)[0]

    def timer(self, kind: str, station: int, *options: str) -> subprocess.Popen[str]:
        """Start the `volcal` command that systemd's timer would start, and return its process."""
        return self.command("start", "--kind", kind, "--wait", "--stations", str(station), *options, timer=True)

    def _start(self, command: list[str], **how: Any) -> subprocess.Popen[str]:
        process = subprocess.Popen(command, text=True, **how)  # noqa: S603  our own interpreter and modules
        self.processes.append(process)
        return process


def settings_text(ready: Mapping[str, Any], changes: Mapping[str, str]) -> str:
    """Return the shipped settings of the case study, changed for this service.

    The machine's addresses are those of the simulated plant, and the sections that a service needs are added.
    """
    text = CASE_STUDY.read_text(encoding="utf-8")
    exchanged = {
        "port = 5021": f"port = {ready['time']['port']}",
        "port = 5020\n\n": f"port = {ready['modbus']['port']}\n\n",
        "port = 29536": f"port = {ready['can']['options']['port']}",
        "port = 5022\n\n": f"port = {ready['control']['port']}\n\n",
        '"machines/': f'"{SHIPPED_CONFIGURATION}/machines/',
        '"artefacts/': f'"{SHIPPED_CONFIGURATION}/artefacts/',
        '"../runs"': '"state"',
        **changes,
    }
    for former, now in exchanged.items():
        if former not in text:
            raise ValueError(f"the shipped settings have no {former!r}")
        text = text.replace(former, now)
    return text + SECTIONS.format(port=free_port())


def free_port() -> int:
    with socket.create_server(("127.0.0.1", 0)) as listener:
        return int(listener.getsockname()[1])
