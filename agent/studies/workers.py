"""Workers of a study. They apply one task to many items, on the cores of this computer or on a cluster.

Every item is computed independently of the others, in one thread, with its own random generator. The results therefore
do not depend on the number of workers, or on the worker that computes an item.
"""

from __future__ import annotations

import multiprocessing
import os
import pickle
import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from typing import Protocol, Self, TypeVar

import numpy as np
from threadpoolctl import threadpool_limits  # type: ignore[import-untyped]

from agent.errors import RunError
from agent.studies.chunks import Chunk, run_chunk, split_into_chunks
from drivers.errors import ConfigurationError

Item = TypeVar("Item")
Result = TypeVar("Result")

OnItemsDone = Callable[[int], None]
"""Callback with the number of items done."""

END_S = 5.0
"""Time to wait for a terminated process, in s."""


class Workers(Protocol):
    """Interface of workers that apply a task to many items.

    The method `map` returns the results in the order of the items. The task, the items and the results must be
    picklable. A picklable task is a module-level function, a `functools.partial` of such a function, or an instance of
    a dataclass with `__call__`. If an item fails, the work ends with an error that names the item.
    """

    def map(self, task: Callable[[Item], Result], items: Sequence[Item], done: OnItemsDone) -> list[Result]: ...


def generator(seed: int, *item: int) -> np.random.Generator:
    """Return the random generator for one item of a study, computed from the seed and the numbers `item` that identify
    the item. The generators of different items are independent.
    """
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=item))


def local_cores() -> int:
    """Return the number of cores that this process may use."""
    return len(os.sched_getaffinity(0))


class LocalWorkers:
    """Worker processes on this computer. They are started at first use and stopped at the end of the `with` block. If
    there is only one worker or only one item, no process is started, and the task runs in the calling process.

    Raises VolcalError with the name of the item if an item fails, and RunError if a process dies.
    """

    def __init__(self, processes: int | None = None) -> None:
        self.processes = local_cores() if processes is None else processes
        if self.processes < 1:
            raise ConfigurationError(f"at least one worker is needed, not {self.processes}", key="--workers")
        self._pool: ProcessPoolExecutor | None = None
        self._others: frozenset[int | None] = frozenset()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        if self._pool is not None:
            self._pool.shutdown()
            self._pool = None

    def map(self, task: Callable[[Item], Result], items: Sequence[Item], done: OnItemsDone) -> list[Result]:
        pickled = pickle.dumps(task)
        if self.processes == 1 or len(items) < 2:
            return _run_in_process(pickled, items, done)
        chunks = split_into_chunks(items, self.processes)
        try:
            return self._in_processes(pickled, chunks, done)
        except BrokenProcessPool:
            self._stop()
            hint = "if memory was short, use fewer --workers"
            raise RunError("a worker process died during its work", hint=hint) from None
        except BaseException:
            self._stop()
            raise

    def _in_processes(self, task: bytes, chunks: Sequence[Chunk[Item]], done: OnItemsDone) -> list[Result]:
        pool = self._started()
        with _without_interrupt():
            futures: dict[Future[list[Result]], int] = {
                pool.submit(run_chunk, task, chunk): number for number, chunk in enumerate(chunks)
            }
        found: list[list[Result]] = [[] for _ in chunks]
        finished = 0
        for future in as_completed(futures):
            number = futures[future]
            found[number] = future.result()
            finished += len(found[number])
            done(finished)
        return [result for results in found for result in results]

    def _started(self) -> ProcessPoolExecutor:
        if self._pool is None:
            self._others = frozenset(child.pid for child in multiprocessing.active_children())
            context = multiprocessing.get_context("spawn")  # a fork copies locks that other threads hold
            self._pool = ProcessPoolExecutor(self.processes, mp_context=context, initializer=_end_with_parent)
        return self._pool

    def _stop(self) -> None:
        """Terminate the processes immediately, then shut down the pool and the thread by which it manages them.

        Otherwise that thread would close a pipe at the interpreter's exit while data are still being written to it.
        """
        if self._pool is None:
            return
        own = [child for child in multiprocessing.active_children() if child.pid not in self._others]
        for child in own:
            child.terminate()
        for child in own:
            child.join(END_S)
        self._pool.shutdown(cancel_futures=True)
        self._pool = None


def _run_in_process(task: bytes, items: Sequence[Item], done: OnItemsDone) -> list[Result]:
    """Compute the results in this process. The task is pickled and unpickled as it is for other processes, because
    unpickling may change the memory layout of an array."""
    found: list[Result] = []
    with threadpool_limits(limits=1):
        for number, item in enumerate(items):
            found += run_chunk(task, Chunk(number, [item]))
            done(len(found))
    return found


@contextmanager
def _without_interrupt() -> Iterator[None]:
    """Block the keyboard interrupt in processes started inside the `with` block; only this process handles it."""
    former = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, former)


def _end_with_parent() -> None:
    """End this worker when its parent ends. The worker itself holds open the pipe on which it waits for work, so
    without this it would outlive a killed parent."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        threading.Thread(target=_exit_after, args=(parent.join,), daemon=True).start()


def _exit_after(wait: Callable[[], None]) -> None:
    wait()
    os._exit(1)
