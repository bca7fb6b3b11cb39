"""Study workers on a Dask cluster. The package `distributed` is an optional dependency: `pip install volcal[cluster]`.

Three waits have a time limit: the wait for the connection, the wait for the first worker, and, while no result arrives,
the wait for a response of the scheduler. The computing time of a chunk is not limited.
"""

from __future__ import annotations

import asyncio
import logging
import pickle
import platform
import socket
import struct
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import CancelledError, Executor
from concurrent.futures import Future as LocalFuture
from contextlib import contextmanager
from functools import partial
from importlib.metadata import version
from typing import Any, Self, TypeVar
from urllib.parse import urlsplit
from weakref import WeakSet

from distributed import Client, Future, KilledWorker

from agent.errors import RunError
from agent.studies.workers import OnItemsDone, in_chunks, run_chunk
from drivers.errors import ConfigurationError, LinkLost, LinkTimeout, VolcalError

Item = TypeVar("Item")
Result = TypeVar("Result")

CONNECT_S = 10.0
FIRST_WORKER_S = 30.0
SIGN_OF_LIFE_S = 10.0
POLL_S = 2.0
CLOSE_S = 5.0
SCHEMES = ("tcp", "tls")

_HEADER = struct.Struct("<Q")  # number of message bytes that follow
_MAX_GREETING_BYTES = 1 << 20


class DaskWorkers:
    """Workers of the Dask scheduler at `address`, which are connected inside the `with` block.

    Raises ConfigurationError if the address is invalid or the software versions differ. Raises LinkLost or LinkTimeout
    if the scheduler or the workers cannot be reached or the connection is lost. Raises RunError if workers died
    repeatedly, and VolcalError, with the name of the item, if the task failed for an item.
    """

    def __init__(self, address: str) -> None:
        self._address = _checked_address(address)
        self._client: Client | None = None

    def __enter__(self) -> Self:
        # The errors raised here already report lost connections, which distributed would log as well.
        for name in ("distributed", "distributed.client"):
            logging.getLogger(name).setLevel(logging.CRITICAL)
        try:
            _check_greeting(self._address)
            self._client = _client(self._address)
        except OSError as error:
            hint = "is `dask scheduler` running there, and may this computer reach it?"
            raise LinkLost("no Dask scheduler answers", hint=hint, link=self._address) from error
        return self

    def __exit__(self, *_: object) -> None:
        if self._client is not None:
            self._client.close(timeout=CLOSE_S)  # type: ignore[no-untyped-call]
            self._client = None

    def map(self, task: Callable[[Item], Result], items: Sequence[Item], done: OnItemsDone) -> list[Result]:
        if self._client is None:
            raise RuntimeError("the workers are not connected: use them in a with block")
        client = self._client
        hint = f"start one: dask worker {self._address}"
        self._await_worker(client, "the Dask scheduler has no worker", hint)
        threads = max(1, sum(self._workers(client).values()))
        run = partial(run_chunk_on_cluster, pickle.dumps(task), local_software())
        executor = _ClusterExecutor(client)
        try:
            with self._failures_translated():
                return in_chunks(executor, threads, run, items, done, lambda: self._check(client), POLL_S)
        except BaseException:
            executor.shutdown(wait=False, cancel_futures=True)
            raise

    def _check(self, client: Client) -> None:
        """Raise LinkLost if the scheduler does not respond, and LinkTimeout if it has no workers left."""
        if not self._workers(client):
            hint = "check that the workers have the same volcal[cluster] and enough memory"
            self._await_worker(client, "the Dask scheduler has no workers left", hint)

    def _await_worker(self, client: Client, message: str, hint: str) -> None:
        try:
            client.wait_for_workers(1, timeout=FIRST_WORKER_S)
        except TimeoutError:
            raise LinkTimeout(message, hint=hint, link=self._address) from None

    def _workers(self, client: Client) -> dict[str, int]:
        """Return the number of threads of each worker. Raises LinkLost if the scheduler does not respond."""
        scheduler = client.scheduler
        if scheduler is None or client.status != "running":
            raise self._connection_lost()
        try:
            threads: dict[str, int] = client.sync(scheduler.ncores, callback_timeout=SIGN_OF_LIFE_S)  # type: ignore[no-untyped-call]
        except (OSError, TimeoutError) as error:
            raise self._connection_lost() from error
        return threads

    @contextmanager
    def _failures_translated(self) -> Iterator[None]:
        try:
            yield
        except VolcalError:
            raise
        except KilledWorker as error:
            hint = "check the memory of the workers"
            raise RunError("workers of the cluster died repeatedly", hint=hint, link=self._address) from error
        except (CancelledError, OSError) as error:
            raise self._connection_lost() from error
        except (ImportError, RuntimeError, AttributeError, pickle.UnpicklingError) as error:
            hint = "install the same volcal[cluster] on scheduler and workers"
            message = f"the cluster cannot run the task: {' '.join(str(error).split())}"
            raise ConfigurationError(message, hint=hint, link=self._address) from error

    def _connection_lost(self) -> LinkLost:
        hint = "start the study again; the same seed gives the same numbers"
        return LinkLost("the connection to the Dask scheduler was lost during the work", hint=hint, link=self._address)


class _ClusterExecutor(Executor):
    """Executor whose results, once fetched, no longer depend on the workers that computed them.

    The executor of distributed looks at the state of a task again after it has fetched the result. If the worker that
    holds the result dies between the two, the work ends with a ValueError, although the result is here.
    """

    def __init__(self, client: Client) -> None:
        self._client = client
        self._loop: asyncio.AbstractEventLoop = client.loop.asyncio_loop  # type: ignore[union-attr]  # connected
        # A task that nothing here refers to any more is let go of on the cluster: its result, once fetched, takes no
        # memory there and is not computed again when its worker dies.
        self._submitted: WeakSet[Future[Any]] = WeakSet()

    def submit(self, function: Callable[..., Result], /, *arguments: Any, **named: Any) -> LocalFuture[Result]:
        remote = self._client.submit(function, *arguments, **named, pure=False)
        self._submitted.add(remote)
        return asyncio.run_coroutine_threadsafe(_fetched(remote), self._loop)

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """Cancel what is not finished, if `cancel_futures` is true and the scheduler is still connected."""
        if cancel_futures and self._client.status == "running":
            self._client.cancel(list(self._submitted))  # type: ignore[no-untyped-call]


async def _fetched(remote: Future[Any]) -> Any:
    """Return the result of a task, which is computed again if it was lost. Raises what the task raised."""
    return await remote


def local_software() -> dict[str, str]:
    """Return the versions of all software that affects the numbers of a study."""
    names = ("volcal", "numpy", "scipy")
    return {"Python": ".".join(platform.python_version_tuple()[:2]), **{name: version(name) for name in names}}


def run_chunk_on_cluster(task: bytes, software: Mapping[str, str], first: int, items: Sequence[Any]) -> list[Any]:
    """Return the results of `run_chunk`, computed on a computer of the cluster.

    `software` contains the software versions of the computer that submitted the items. Raises ConfigurationError if the
    versions on this computer differ.
    """
    here = local_software()
    for name, wanted in software.items():
        if here[name] != wanted:
            raise ConfigurationError(
                f"a worker of the cluster has {name} {here[name]}, this computer {wanted}",
                hint="results would depend on the computer: install the same versions everywhere",
            )
    return run_chunk(task, first, items)


def _check_greeting(address: str) -> None:
    """Raise ConnectionError unless a Dask scheduler sends its greeting at `address`. Without this check the client
    would wait forever if another program accepts the connection."""
    parts = urlsplit(address)
    if parts.scheme != "tcp":
        return
    with socket.create_connection((str(parts.hostname), int(parts.port or 0)), timeout=CONNECT_S) as connection:
        header = connection.recv(_HEADER.size, socket.MSG_WAITALL)
    if len(header) < _HEADER.size or _HEADER.unpack(header)[0] > _MAX_GREETING_BYTES:
        raise ConnectionError("the response is not a greeting of a Dask scheduler")


def _client(address: str) -> Client:
    return Client(address, timeout=CONNECT_S, name="volcal")  # type: ignore[no-untyped-call]


def _checked_address(address: str) -> str:
    hint = "give it as tcp://HOST:PORT"
    try:
        parts = urlsplit(address)
        port = parts.port
    except ValueError:
        port = None
    if port is None or parts.scheme not in SCHEMES or not parts.hostname or parts.path not in ("", "/"):
        raise ConfigurationError(f"'{address}' is not an address of a Dask scheduler", hint=hint, key="--cluster")
    return address
