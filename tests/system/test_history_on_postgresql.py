"""A plant's history in a real PostgreSQL: two agents at once, a server that goes away and comes back.

PostgreSQL refuses to run as root, so the server is started as another user where the tests are root. Without its
programs (Debian: `postgresql`) the tests fail and say so; ``VOLCAL_WITHOUT_POSTGRESQL=1`` skips them, and they are
counted as skipped.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from tempfile import TemporaryDirectory

import psycopg
import pytest
from aloud import NOT_HERE
from nights import Night, short_document
from postgresql_server import PASSWORD, Server, running_server
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

GUIDE = Path(__file__).resolve().parents[2] / "docs" / "how-to" / "read-the-history.md"
SWITCH = "VOLCAL_WITHOUT_POSTGRESQL"


@pytest.fixture(scope="module")
def server() -> Iterator[Server]:
    try:
        with running_server() as started:
            yield started
    except FileNotFoundError as missing:
        if os.environ.get(SWITCH) == "1":
            pytest.skip(f"{NOT_HERE}: history on PostgreSQL: not installed, and {SWITCH}=1 says it need not be")
        pytest.fail(f"{missing}, or set {SWITCH}=1 to go without this proof")


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


def test_a_machine_may_be_given_its_own_rows_only(
    server: Server, measured: tuple[Path, object], tmp_path: Path
) -> None:
    """By the statements of the guide: a role writes and sees the rows of the machine that has its name, and the role of
    the plant sees all rows and writes none."""
    with closing(HistoryStore(server.address("mill-8"))) as store:
        sync(renamed(measured[0], "mill-8", tmp_path), store)
    statements = GUIDE.read_text(encoding="utf-8").partition("```sql\n")[2].partition("```")[0]
    with psycopg.connect(**server.login, autocommit=True) as connection:
        connection.execute(statements)
        connection.execute(f"ALTER ROLE \"mill-7\" PASSWORD '{PASSWORD}'; ALTER ROLE plant PASSWORD '{PASSWORD}'")

    def opened(role: str) -> HistoryStore:
        address = server.address("mill-7")
        return HistoryStore(replace(address, url=address.url.set(username=role)))

    with closing(opened("mill-7")) as own:
        assert sync(renamed(measured[0], "mill-7", tmp_path), own)
        assert own.machines() == ("mill-7",)
        with pytest.raises(LinkLost, match="row-level security"):
            sync(renamed(measured[0], "mill-9", tmp_path), own)
    with closing(opened("plant")) as plant:
        assert {"mill-7", "mill-8"} <= {run.machine for run in plant.recent_runs(30, datetime.now(UTC))}
        with pytest.raises(LinkLost, match="permission denied"):
            sync(renamed(measured[0], "mill-10", tmp_path), plant)
