"""The real `volcal serve` against the real `volcal simulate`, each a process of its own, and a plain HTTP client."""

from __future__ import annotations

import json
import os
import signal
import socket
import subprocess
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from queue import SimpleQueue
from typing import Any

import httpx
from simulated import COMMAND, PATIENCE_S, SHORT_SET, configured, scenario_text, simulated, wait_for

SHORT = {
    'position_set = "S3"': 'position_set = "short.csv"\nstations = [1]',
    "[verification]\nstations = [1, 4]": (
        "[verification]\nstations = [1]\npositions_deg = [[20.0, 25.0]]\nmax_chi2 = 1e3"
    ),
    "[timing]": "[gates]\nmin_degrees_of_freedom = 1\nmax_unmeasured_fraction = 10.0\nmax_chi2 = 1e3\n\n[timing]",
}
AT_ONCE = "\n[service]\nport = 0\nwarm_up_minutes = 0\n"


@contextmanager
def simulator(directory: Path, sections: str = "") -> Iterator[tuple[subprocess.Popen[bytes], dict[str, Any]]]:
    """Run the simulator with a bad machine. `sections` are further sections of its scenario."""
    path = directory / "scenario.toml"
    path.write_text(scenario_text().replace("[truth]", "[truth]\nscale = 4.0") + sections)
    with simulated(path) as started:
        yield started


def short_settings(ready: dict[str, Any], directory: Path, service: str = AT_ONCE) -> Path:
    """Three positions and one held out at one station, gates open: a whole run is a few seconds."""
    path = configured(ready, directory)
    text = path.read_text()
    for former, now in SHORT.items():
        assert former in text
        text = text.replace(former, now)
    path.write_text(text + service)
    (directory / "short.csv").write_text(SHORT_SET)
    return path


@dataclass
class Service:
    process: subprocess.Popen[str]
    directory: Path
    config: Path

    @property
    def state(self) -> Path:
        return self.directory / "state"

    @property
    def token(self) -> str:
        return (self.state / "token").read_text().strip()

    @property
    def url(self) -> str:
        return str(json.loads((self.state / "service.json").read_text())["url"])

    def client(self, **headers: str) -> httpx.Client:
        # The service speaks plain HTTP here; certificates of authorities would be read for each request without need.
        return httpx.Client(base_url=self.url, headers=headers, timeout=PATIENCE_S, trust_env=False, verify=False)  # noqa: S501

    def post(self, path: str, body: Any = None) -> httpx.Response:
        with self.client(Authorization=f"Bearer {self.token}") as client:
            return client.post(path, json=body)

    def get(self, path: str) -> Any:
        with self.client() as client:
            answer = client.get(path)
        assert answer.status_code == 200, answer.text
        return answer.json()

    def status(self) -> dict[str, Any]:
        document: dict[str, Any] = self.get("/api/status")
        return document

    def start(self, kind: str = "calibrate", **body: Any) -> str:
        answer = self.post("/api/start", {"kind": kind, "consent": True, **body})
        assert answer.status_code == 202, answer.text
        return str(answer.json()["run_id"])

    def reached(self, *states: str, within_s: float = PATIENCE_S) -> dict[str, Any]:
        def there() -> dict[str, Any] | None:
            assert self.process.poll() is None, self.log()
            now = self.status()
            return now if now["state"] in states else None

        found: dict[str, Any] = wait_for(there, f"{states}", within_s)
        return found

    def until(self, condition: Callable[[dict[str, Any]], Any], what: str, within_s: float = PATIENCE_S) -> Any:
        """Wait until `condition` holds for the status and return its value; a run that ends before is a failure."""

        def there() -> Any:
            now = self.status()
            found = condition(now)
            assert found or now["state"] not in ("faulted", "refused", "complete"), now
            return found

        return wait_for(there, what, within_s)

    def log(self) -> list[dict[str, Any]]:
        return [json.loads(line) for line in (self.directory / "log").read_text().splitlines() if line]

    def command(self, *arguments: str, config: Path | None = None) -> subprocess.CompletedProcess[str]:
        command = [*COMMAND, *arguments, "--config", str(config or self.config)]
        return subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE_S, check=False)

    def end(self, number: int = signal.SIGTERM) -> int:
        self.process.send_signal(number)
        return self.process.wait(PATIENCE_S)


@contextmanager
def service(config: Path, **environment: str) -> Iterator[Service]:
    directory = config.parent
    (directory / "state" / "service.json").unlink(missing_ok=True)  # of one that was killed
    with (directory / "log").open("a") as log:
        process = subprocess.Popen(
            [*COMMAND, "serve", "--config", str(config)],
            cwd=directory,
            stdout=log,
            stderr=subprocess.STDOUT,
            text=True,
            env={**os.environ, **environment},
            process_group=0,
        )
    served = Service(process, directory, config)
    try:
        place = served.state / "service.json"
        wait_for(lambda: place.exists() or process.poll() is not None, "the service")
        yield served
    finally:
        with suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)  # with it what draws a report that nobody waits for
        process.wait(PATIENCE_S)


class Systemd:
    """Reads all the while, as systemd does: a queue of ten datagrams is soon full."""

    def __init__(self, listening: socket.socket) -> None:
        self._listening = listening
        self._messages: SimpleQueue[dict[str, str]] = SimpleQueue()
        threading.Thread(target=self._read, daemon=True).start()

    def _read(self) -> None:
        with suppress(OSError):
            while message := self._listening.recv(4096):
                self._messages.put(dict(line.split("=", 1) for line in message.decode().splitlines()))

    def told_until(self, key: str, text: str = "") -> list[dict[str, str]]:
        """Every message up to the first one that has `key` with a value that contains `text`."""
        messages = [self._messages.get(timeout=PATIENCE_S)]
        while text not in messages[-1].get(key, "") or key not in messages[-1]:
            messages.append(self._messages.get(timeout=PATIENCE_S))
        return messages


@contextmanager
def systemd_socket(name: str) -> Iterator[Systemd]:
    """Listen as systemd does on the socket `name` of NOTIFY_SOCKET; `@…` is an abstract socket."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as listening:
        listening.bind(f"\0{name[1:]}" if name.startswith("@") else name)
        try:
            yield Systemd(listening)
        finally:
            listening.shutdown(socket.SHUT_RDWR)
