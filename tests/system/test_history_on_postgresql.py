"""A plant's history in a real PostgreSQL: two agents at once, a server that goes away and comes back.

PostgreSQL refuses to run as root, so the server is started as another user where the tests are root. Without its
programs (Debian: `postgresql`) the tests fail and say so; ``VOLCAL_WITHOUT_POSTGRESQL=1`` skips them, and they are
counted as skipped.
"""

from __future__ import annotations

import os
import pwd
import shutil
import socket
import subprocess
import tempfile
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import pytest
from aloud import NOT_HERE
from nights import Night, short_document
from sqlalchemy import URL
from stored_run import stored_run

from agent.execution.journal_copy import copy_journal
from agent.execution.run_record import run_ids
from agent.execution.states import RunState
from agent.history.database_url import DatabaseAddress
from agent.history.feed import update_history
from agent.history.store import HistoryStore
from agent.history.sync import sync
from agent.planning.job_preparation import prepare_job
from agent.settings.schema import Settings
from drivers.errors import LinkLost

PASSWORD = "for-this-test-only"  # noqa: S105  of a server that lives as long as the test
SWITCH = "VOLCAL_WITHOUT_POSTGRESQL"


def programs() -> Path:
    """Return the directory of initdb and pg_ctl of the newest version."""
    found = shutil.which("pg_ctl")
    if found is not None:
        return Path(found).resolve().parent
    for folder in sorted(Path("/usr/lib/postgresql").glob("*/bin"), reverse=True):
        return folder
    if os.environ.get(SWITCH) == "1":
        pytest.skip(f"{NOT_HERE}: history on PostgreSQL: not installed, and {SWITCH}=1 says it need not be")
    pytest.fail(f"PostgreSQL is not installed: apt-get install postgresql, or set {SWITCH}=1 to go without this proof")


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


@pytest.fixture(scope="module")
def server() -> Iterator[Server]:
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


@pytest.fixture(scope="module")
def measured() -> Iterator[tuple[Path, dict[str, object]]]:
    """A real run on the simulated machine, and its settings."""
    with TemporaryDirectory() as directory:
        state = Path(directory) / "state"
        document = short_document(state)
        ended = Night().run(document, files=False)
        assert ended.outcome.state is RunState.COMPLETE, stored_run(state).states
        yield state, document


def renamed(state: Path, machine: str, into: Path) -> Path:
    """The same journal as that of another machine."""
    copy = into / machine
    copy.mkdir()
    copy_journal(state, copy, lambda settings: {**settings, "history": {"machine": machine}})
    return copy


def test_two_agents_feed_one_database_at_once(server: Server, measured: tuple[Path, object], tmp_path: Path) -> None:
    """Both make the tables, both write, ten times over; each run is there once, and whole."""
    machines = ("mill-4", "mill-5")
    journals = {machine: renamed(measured[0], machine, tmp_path) for machine in machines}

    def agent(machine: str) -> int:
        written = 0
        for _ in range(10):
            with closing(HistoryStore(server.address(machine))) as store:
                written += len(sync(journals[machine], store))
        return written

    with ThreadPoolExecutor(4) as pool:
        counts = list(pool.map(agent, (*machines, *machines)))
    assert sum(counts) >= len(machines)
    with closing(HistoryStore(server.address("mill-4"))) as store:
        assert set(machines) <= set(store.machines())
        for machine in machines:
            (run,) = store.runs(machine)
            assert run.run_id == run_ids(measured[0])[0]
            assert run.accepted
            assert {"EXX[1]", "A0Z"} <= {parameter.name for parameter in run.parameters}
            assert {"artefact", "ambient"} <= {temperature.sensor for temperature in run.temperatures}
            assert run.started.tzinfo is not None


def test_a_lost_server_disturbs_nothing_and_is_fed_later(
    server: Server, measured: tuple[Path, dict[str, object]], tmp_path: Path
) -> None:
    state, document = measured
    secret = tmp_path / "password"
    secret.write_text(PASSWORD)
    secret.chmod(0o600)
    history = {
        "url": f"postgresql://volcal@127.0.0.1:{server.port}/postgres",
        "credentials_file": str(secret),
        "machine": "case-study",
        "timeout_s": 2.0,
    }
    settings = Settings.model_validate({**document, "history": history})
    assert prepare_job(settings, tmp_path).settings.history.url == history["url"]
    (run_id,) = run_ids(state)
    server.stop()
    complaint = update_history(settings, run_id)
    assert "history sync" in complaint
    assert PASSWORD not in complaint
    with pytest.raises(LinkLost):
        HistoryStore(server.address("case-study"))
    server.start()
    assert update_history(settings, run_id) == ""
    with closing(HistoryStore(server.address("case-study"))) as store:
        assert [run.run_id for run in store.runs("case-study")] == [run_id]


def test_a_wrong_password_is_reported_without_showing_it(server: Server) -> None:
    address = server.address("case-study")
    wrong = DatabaseAddress(address.url.set(password=PASSWORD[::-1]), address.machine, 2.0)
    with pytest.raises(LinkLost) as told:
        HistoryStore(wrong)
    assert PASSWORD[::-1] not in str(told.value)
