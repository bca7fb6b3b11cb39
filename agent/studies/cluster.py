"""The work of a study on a Dask cluster. `distributed` is an optional part: `pip install volcal[cluster]`.

Every wait is bounded: for the connection, for the first worker, and for a sign of life of the scheduler whenever
nothing comes back. How long a chunk computes is not.
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

_HEADER = struct.Struct("<Q")  # how many bytes of message follow
_LONGEST_GREETING = 1 << 20


class DaskWorkers:
    """The workers of the scheduler at `address`, connected within the block.

    Raises ConfigurationError for what is no address or another software there, LinkLost and LinkTimeout for a scheduler
    or workers that are not there (any more), RunError for a worker that died, and the named error of a failed item.
    """

    def __init__(self, address: str) -> None:
        self._address = _checked(address)
        self._client: Client | None = None

    def __enter__(self) -> Self:
        # What distributed logs about lost connections is said by the errors raised here.
        for name in ("distributed", "distributed.client"):
            logging.getLogger(name).setLevel(logging.CRITICAL)
        try:
            _greet(self._address)
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
            found = self._gathered(client, futures, done)
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

    def _gathered(self, client: Client, futures: Sequence[Work], done: OnItemsDone) -> list[list[Any]]:
        """Results in the order of the futures, taken as they come."""
        number = {future.key: place for place, future in enumerate(futures)}
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
            raise self._lost() from error
        return ready, rest

    def _result(self, client: Client, future: Work) -> list[Any]:
        """What a ready future holds. Its worker may have died since then: it is computed once more, as long as that
        takes, while the scheduler gives signs of life and has workers."""
        loop = client.loop.asyncio_loop  # type: ignore[union-attr]
        fetching = client.gather(future, asynchronous=True)  # type: ignore[no-untyped-call]
        coming = asyncio.run_coroutine_threadsafe(fetching, loop)
        timeout = _WorkerTimeout(self._address)
        try:
            while not futures_done([coming], timeout=POLL_S).done:
                timeout.update(bool(self._workers(client)))
        finally:
            coming.cancel()  # nothing where it has ended
        return self._taken(coming)

    def _taken(self, ended: ConcurrentFuture[list[Any]]) -> list[Any]:
        try:
            return ended.result()
        except VolcalError:
            raise
        except KilledWorker as error:
            hint = "was memory short there?"
            raise RunError("workers of the cluster died again and again", hint=hint, link=self._address) from error
        except (CancelledError, OSError) as error:
            raise self._lost() from error
        except (ImportError, RuntimeError, AttributeError, pickle.UnpicklingError) as error:
            hint = "install the same volcal[cluster] on scheduler and workers"
            message = f"the cluster does not understand the work: {' '.join(str(error).split())}"
            raise ConfigurationError(message, hint=hint, link=self._address) from error

    def _workers(self, client: Client) -> dict[str, int]:
        """Threads of each worker, asked of the scheduler: a sign of its life too."""
        scheduler = client.scheduler
        if scheduler is None or client.status != "running":
            raise self._lost()
        try:
            threads: dict[str, int] = client.sync(scheduler.ncores, callback_timeout=SIGN_OF_LIFE_S)  # type: ignore[no-untyped-call]
        except (OSError, TimeoutError) as error:
            raise self._lost() from error
        return threads

    def _lost(self) -> LinkLost:
        hint = "start the study again; the same seed gives the same numbers"
        return LinkLost("the Dask scheduler is gone in the middle of the work", hint=hint, link=self._address)


class _WorkerTimeout:
    """How long the scheduler has been without workers, looked at every POLL_S."""

    def __init__(self, address: str) -> None:
        self._address = address
        self._seconds = 0.0

    def update(self, has_workers: bool) -> None:
        """LinkTimeout after FIRST_WORKER_S of nobody."""
        self._seconds = 0.0 if has_workers else self._seconds + POLL_S
        if self._seconds > FIRST_WORKER_S:
            hint = "have they the same volcal[cluster], and memory enough?"
            raise LinkTimeout("the Dask scheduler has no worker any more", hint=hint, link=self._address)


def _greet(address: str) -> None:
    """A client waits without end for the greeting of whatever accepts its connection: look first whether one comes."""
    parts = urlsplit(address)
    if parts.scheme != "tcp":
        return
    with socket.create_connection((str(parts.hostname), int(parts.port or 0)), timeout=CONNECT_S) as connection:
        header = connection.recv(_HEADER.size, socket.MSG_WAITALL)
    if len(header) < _HEADER.size or _HEADER.unpack(header)[0] > _LONGEST_GREETING:
        raise ConnectionError("this is no greeting of a Dask scheduler")


def _client(address: str) -> Client:
    return Client(address, timeout=CONNECT_S, name="volcal")  # type: ignore[no-untyped-call]


def _checked(address: str) -> str:
    hint = "give it as tcp://HOST:PORT"
    try:
        parts = urlsplit(address)
        port = parts.port
    except ValueError:
        port = None
    if port is None or parts.scheme not in SCHEMES or not parts.hostname or parts.path not in ("", "/"):
        raise ConfigurationError(f"'{address}' is no address of a Dask scheduler", hint=hint, key="--cluster")
    return address
