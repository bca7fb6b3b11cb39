"""A PostgreSQL server of its own on loopback, for as long as a test or a benchmark takes.

PostgreSQL refuses to run as root, so the server is started as another user if the caller is root.
"""

from __future__ import annotations

import os
import pwd
import shutil
import socket
import subprocess
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from sqlalchemy import URL

from agent.history.database_url import DatabaseAddress

PASSWORD = "for-this-test-only"  # noqa: S105  of a server that lives as long as the test


def programs() -> Path:
    """Return the directory of initdb and pg_ctl of the newest version. Raise FileNotFoundError without them."""
    found = shutil.which("pg_ctl")
    if found is not None:
        return Path(found).resolve().parent
    for folder in sorted(Path("/usr/lib/postgresql").glob("*/bin"), reverse=True):
        return folder
    raise FileNotFoundError("PostgreSQL is not installed: apt-get install postgresql")


@dataclass(frozen=True)
class Server:
    """A cluster of its own on loopback, with a password for everybody."""

    bin: Path
    folder: Path
    port: int
    user: str

    def start(self) -> None:
        options = f"-h 127.0.0.1 -p {self.port} -k {self.folder} -c fsync=off -c shared_buffers=16MB"
        self._run("pg_ctl", "-D", self.data, "-o", options, "-l", str(self.folder / "log"), "-w", "-t", "30", "start")

    def stop(self) -> None:
        self._run("pg_ctl", "-D", self.data, "-m", "immediate", "-w", "-t", "30", "stop")

    def create(self) -> None:
        secret = self.folder / "password"
        secret.write_text(PASSWORD)
        secret.chmod(0o644)
        self._run("initdb", "-D", self.data, "-U", "volcal", "-A", "scram-sha-256", f"--pwfile={secret}", "-E", "UTF8")

    @property
    def data(self) -> str:
        return str(self.folder / "data")

    @property
    def login(self) -> dict[str, Any]:
        """Arguments with which psycopg connects as the owner of the database."""
        where = {"host": "127.0.0.1", "port": self.port, "dbname": "postgres"}
        return {**where, "user": "volcal", "password": PASSWORD}

    def address(self, machine: str) -> DatabaseAddress:
        url = URL.create("postgresql+psycopg", "volcal", PASSWORD, "127.0.0.1", self.port, "postgres")
        return DatabaseAddress(url, machine, 5.0)

    def _run(self, program: str, *arguments: str) -> None:
        command = [str(self.bin / program), *arguments]
        if os.geteuid() == 0:
            command = ["runuser", "-u", self.user, "--", *command]
        with (self.folder / f"{program}.out").open("ab") as out:
            done = subprocess.run(command, stdout=out, stderr=out, cwd=self.folder, check=False, timeout=600.0)
        assert done.returncode == 0, (self.folder / f"{program}.out").read_text()


@contextmanager
def running_server() -> Iterator[Server]:
    """Raise FileNotFoundError if PostgreSQL is not installed."""
    found = programs()
    with tempfile.TemporaryDirectory(prefix="volcal-pg-") as directory:
        user = next((name for name in ("postgres", "nobody") if _exists(name)), "nobody")
        server = Server(found, Path(directory), _free_port(), user)
        if os.geteuid() == 0:
            os.chown(directory, pwd.getpwnam(user).pw_uid, -1)
        server.create()
        server.start()
        try:
            yield server
        finally:
            server.stop()


def _exists(user: str) -> bool:
    return any(entry.pw_name == user for entry in pwd.getpwall())


def _free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])
