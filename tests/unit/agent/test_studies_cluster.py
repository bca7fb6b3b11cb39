"""Work on a Dask cluster of real processes: the same numbers as locally, and a clear message for every failure."""

from __future__ import annotations

import asyncio
import os
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from threading import Event
from typing import Any

import dask
import numpy as np
import pytest
import study_tasks
from distributed import Client, LocalCluster

from agent.errors import RunError
from agent.studies import cluster
from agent.studies.cluster import DaskWorkers
from agent.studies.workers import LocalWorkers
from drivers.errors import ConfigurationError, InputError, LinkLost, LinkTimeout, VolcalError

HERE = str(Path(__file__).parent)


def ignore(_: int) -> None:
    """Ignore the progress."""


def started(workers: int) -> LocalCluster:
    """Start a cluster whose worker processes can import the tasks of these tests."""
    assert HERE in sys.path
    with dask.config.set({"distributed.scheduler.allowed-failures": 1}):
        return LocalCluster(n_workers=workers, threads_per_worker=1, processes=True, dashboard_address="127.0.0.1:0")


@pytest.fixture(scope="module")
def address() -> Iterator[str]:
    with started(2) as running:
        yield running.scheduler_address


def dask_process(*arguments: str) -> subprocess.Popen[str]:
    command = [sys.executable, "-m", "dask", *arguments, "--no-dashboard"]
    environment = {**os.environ, "PYTHONPATH": HERE}
    return subprocess.Popen(command, stderr=subprocess.PIPE, text=True, env=environment)


def address_of(scheduler: subprocess.Popen[str]) -> str:
    """Return the address that the scheduler reports when it is ready."""
    assert scheduler.stderr is not None
    said = next(line for line in scheduler.stderr if "Scheduler at:" in line)
    return said.split()[-1]


def sums() -> study_tasks.Sums:
    whole = np.random.default_rng(3).standard_normal((120, 120))
    return study_tasks.Sums(whole.T[::2, ::2], seed=11)


class TestNumbers:
    def test_they_are_those_of_this_computer_to_the_last_bit(self, address: str) -> None:
        here = np.array(LocalWorkers(1).map(sums(), range(37), ignore))
        told: list[int] = []
        with DaskWorkers(address) as workers:
            there = np.array(workers.map(sums(), range(37), told.append))
            fewer = np.array(workers.map(sums(), range(5), ignore))
        assert there.tobytes() == here.tobytes()
        assert fewer.tobytes() == here[:5].tobytes()
        assert told == sorted(told)
        assert told[-1] == 37

    def test_results_that_are_here_are_let_go_of_on_the_cluster(self, address: str) -> None:
        held = Event()

        def wait_until_released(finished: int) -> None:
            """Wait, with all results here, until the client wants none of the cluster any more."""
            while finished == 37 and Client.current().futures:
                held.wait(0.01)

        with DaskWorkers(address) as workers:
            assert workers.map(study_tasks.squared, range(37), wait_until_released) == [n * n for n in range(37)]


class TestBadEnds:
    def test_other_software_is_refused_before_anything_is_computed(self) -> None:
        other = {**cluster.local_software(), "numpy": "1.0"}
        with pytest.raises(ConfigurationError, match=r"numpy [\d.]+, this computer 1\.0"):
            cluster.run_chunk_on_cluster(b"never read", other, 0, [1])

    def test_a_failing_item_is_named_and_the_workers_go_on(self, address: str) -> None:
        with DaskWorkers(address) as workers:
            with pytest.raises(VolcalError, match=r"ZeroDivisionError: .* \(item 5\)") as failed:
                workers.map(study_tasks.undefined, range(12), ignore)
            assert failed.value.exit_code == 1
            with pytest.raises(InputError, match=r"nothing can be seen \(file set.csv, item 5\)"):
                workers.map(study_tasks.unseen, range(12), ignore)
            assert workers.map(study_tasks.squared, range(3), ignore) == [0, 1, 4]

    @pytest.mark.parametrize(
        "wrong", ["", "here", "tcp://", "tcp://host", "tcp://host:99999", "http://host:1", "host:1"]
    )
    def test_what_is_no_address_is_refused(self, wrong: str) -> None:
        with pytest.raises(ConfigurationError, match="not an address of a Dask scheduler"):
            DaskWorkers(wrong)

    def test_nobody_there_is_said_at_once(self) -> None:
        with socket.create_server(("127.0.0.1", 0)) as server:
            port = server.getsockname()[1]
        with pytest.raises(LinkLost, match=f"no Dask scheduler answers .link tcp://127.0.0.1:{port}"):
            DaskWorkers(f"tcp://127.0.0.1:{port}").__enter__()

    def test_somebody_else_who_says_nothing_is_not_waited_for_without_end(
        self, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        monkeypatch.setattr(cluster, "CONNECT_S", 0.2)
        silent = socket.create_server(("127.0.0.1", 0))
        with silent as server, pytest.raises(LinkLost, match="no Dask scheduler answers"):
            DaskWorkers(f"tcp://127.0.0.1:{server.getsockname()[1]}").__enter__()

    def test_a_scheduler_without_workers_is_not_waited_for_without_end(self, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr(cluster, "FIRST_WORKER_S", 0.5)
        refused = pytest.raises(LinkTimeout, match=r"has no worker .*dask worker tcp://")
        with started(0) as running, DaskWorkers(running.scheduler_address) as workers, refused:
            workers.map(study_tasks.squared, range(3), ignore)

    def test_a_worker_that_dies_of_the_work_is_an_error(self, address: str) -> None:
        with DaskWorkers(address) as workers:
            with pytest.raises(RunError, match="workers of the cluster died"):
                workers.map(study_tasks.deadly, range(12), ignore)
            assert workers.map(study_tasks.squared, range(3), ignore) == [0, 1, 4]

    def test_a_result_that_dies_with_its_worker_is_computed_again_however_long_that_takes(
        self, address: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        killed: list[int] = []
        gather = Client._gather

        async def gathered_from_the_dead(self: Client, *arguments: Any, **options: Any) -> Any:
            """Kill the worker that holds a finished result before the result is fetched."""
            if not killed:
                killed.append(int((tmp_path / "first").read_text()))
                os.kill(killed[0], signal.SIGKILL)
            return await gather(self, *arguments, **options)

        monkeypatch.setattr(Client, "_gather", gathered_from_the_dead)
        monkeypatch.setattr(cluster, "POLL_S", 0.1)
        with DaskWorkers(address) as workers:
            assert workers.map(study_tasks.SlowAgain(str(tmp_path)), range(1), ignore) == [0]
        assert (tmp_path / "again").exists()

    def test_a_result_that_is_here_stays_when_its_worker_dies(
        self, address: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        killed: list[int] = []
        gather = Client._gather

        async def gathered_before_the_death(self: Client, futures: list[Any], *arguments: Any, **options: Any) -> Any:
            """After the result is fetched, kill the worker that holds it and wait until the client knows."""
            result = await gather(self, futures, *arguments, **options)
            if not killed:
                killed.append(int((tmp_path / "first").read_text()))
                os.kill(killed[0], signal.SIGKILL)
                while futures[0].status == "finished":
                    await asyncio.sleep(0.01)
            return result

        monkeypatch.setattr(Client, "_gather", gathered_before_the_death)
        with DaskWorkers(address) as workers:
            assert workers.map(study_tasks.SlowAgain(str(tmp_path)), range(1), ignore) == [0]
        assert killed

    def test_a_scheduler_that_is_killed_in_the_middle_is_noticed(self) -> None:
        scheduler = dask_process("scheduler", "--host", "127.0.0.1", "--port", "0", "--no-show")
        address = address_of(scheduler)
        worker = dask_process("worker", address, "--no-nanny", "--nthreads", "1")
        lost = pytest.raises(LinkLost, match="was lost during the work")
        try:
            with DaskWorkers(address) as workers, lost:
                workers.map(study_tasks.endless_but_first, range(8), lambda _: scheduler.kill())
        finally:
            for process in (worker, scheduler):
                process.kill()
                process.communicate()

    def test_other_software_there_is_refused(self, address: str, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr(cluster, "local_software", lambda: {"scipy": "0.1"})
        with DaskWorkers(address) as workers, pytest.raises(ConfigurationError, match=r"scipy .*, this computer 0.1"):
            workers.map(study_tasks.squared, range(3), ignore)
