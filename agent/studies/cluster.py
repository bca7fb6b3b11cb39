"""Study workers on a Dask cluster. The package `distributed` is an optional dependency: `pip install volcal[cluster]`.

Three waits have a time limit: the wait for the connection, the wait for the first worker, and, while no result arrives,
the wait for a response of the scheduler. The computing time of a chunk is not limited.
"""

from __future__ import annotations

import asyncio
import logging
import pickle
import socket
import struct
from collections.abc import Callable, Sequence
from concurrent.futures import CancelledError
from concurrent.futures import Future as ConcurrentFuture
from concurrent.futures import wait as futures_done
from typing import Any, Self, TypeVar
from urllib.parse import urlsplit

from distributed import Client, Future, KilledWorker, wait

from agent.errors import RunError
from agent.studies.chunks import local_software, run_chunk_on_cluster, split_into_chunks
from agent.studies.workers import OnItemsDone
from drivers.errors import ConfigurationError, LinkLost, LinkTimeout, VolcalError

Item = TypeVar("Item")
Result = TypeVar("Result")
Work = Future[list[Any]]

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
        client = self._connected()
        pickled, software = pickle.dumps(task), local_software()
        chunks = split_into_chunks(items, self._threads(client))
        futures = [client.submit(run_chunk_on_cluster, pickled, chunk, software, pure=False) for chunk in chunks]
        try:
            found = self._collect(client, futures, done)
        except BaseException:
            if client.status == "running":
                client.cancel(futures)  # type: ignore[no-untyped-call]
            raise
        return [result for results in found for result in results]

    def _connected(self) -> Client:
        if self._client is None:
            raise RuntimeError("the workers are not connected: use them in a with block")
        return self._client

    def _threads(self, client: Client) -> int:
        try:
            client.wait_for_workers(1, timeout=FIRST_WORKER_S)
        except TimeoutError:
            hint = f"start one: dask worker {self._address}"
            raise LinkTimeout("the Dask scheduler has no worker", hint=hint, link=self._address) from None
        return max(1, sum(self._workers(client).values()))

    def _collect(self, client: Client, futures: Sequence[Work], done: OnItemsDone) -> list[list[Any]]:
        """Wait for all results and return them in the order of the futures; call `done` as they arrive."""
        number = {future.key: index for index, future in enumerate(futures)}
        found: list[list[Any]] = [[] for _ in futures]
        pending, finished = set(futures), 0
        timeout = _WorkerTimeout(self._address)
        while pending:
            ready, pending = self._next(pending)
            timeout.update(bool(ready or self._workers(client)))
            for future in ready:
                found[number[future.key]] = self._result(client, future)
                finished += len(found[number[future.key]])
            if ready:
                done(finished)
        return found

    def _next(self, pending: set[Work]) -> tuple[set[Work], set[Work]]:
        try:
            ready, rest = wait(pending, timeout=POLL_S, return_when="FIRST_COMPLETED")  # type: ignore[no-untyped-call]
        except TimeoutError:
            return set(), pending
        except CancelledError as error:
            raise self._connection_lost() from error
        return ready, rest

    def _result(self, client: Client, future: Work) -> list[Any]:
        """Return the result of a finished future.

        If the worker that holds the result has died, the scheduler assigns the chunk to another worker. This method
        waits for the new result as long as the scheduler responds and has workers.
        """
        loop = client.loop.asyncio_loop  # type: ignore[union-attr]
        fetching = client.gather(future, asynchronous=True)  # type: ignore[no-untyped-call]
        coming = asyncio.run_coroutine_threadsafe(fetching, loop)
        timeout = _WorkerTimeout(self._address)
        try:
            while not futures_done([coming], timeout=POLL_S).done:
                timeout.update(bool(self._workers(client)))
        finally:
            coming.cancel()  # no effect if it has finished
        return self._unwrap(coming)

    def _unwrap(self, ended: ConcurrentFuture[list[Any]]) -> list[Any]:
        try:
            return ended.result()
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

    def _connection_lost(self) -> LinkLost:
        hint = "start the study again; the same seed gives the same numbers"
        return LinkLost("the connection to the Dask scheduler was lost during the work", hint=hint, link=self._address)


class _WorkerTimeout:
    """Time for which the scheduler has had no workers; `update` must be called every POLL_S seconds."""

    def __init__(self, address: str) -> None:
        self._address = address
        self._seconds = 0.0

    def update(self, has_workers: bool) -> None:
        """Update the time. Raises LinkTimeout after FIRST_WORKER_S seconds without workers."""
        self._seconds = 0.0 if has_workers else self._seconds + POLL_S
        if self._seconds > FIRST_WORKER_S:
            hint = "check that the workers have the same volcal[cluster] and enough memory"
            raise LinkTimeout("the Dask scheduler has no workers left", hint=hint, link=self._address)


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
