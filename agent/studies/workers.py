"""Who does the work of a study: one task for each of many items, on the cores of this computer or of a cluster.

Every item is computed by itself, by the same code and with one thread, and whatever is drawn at random for it comes
from a generator of its own. So the results do not depend on how many workers there are, nor on which of them did what.
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
"""Is told how many items are done."""

END_S = 5.0
"""How long a process that was told to end is waited for."""


class Workers(Protocol):
    """`map` gives the results in the order of the items. Task, items and results must be picklable: a task is a
    function of a module, a `functools.partial` of one, or an instance of a dataclass with `__call__`. An item that
    fails ends the work with an error that names it."""

    def map(self, task: Callable[[Item], Result], items: Sequence[Item], done: OnItemsDone) -> list[Result]: ...


def generator(seed: int, *item: int) -> np.random.Generator:
    """The random numbers of one item of a study: independent of those of every other item."""
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=item))


def local_cores() -> int:
    """How many cores this process may use."""
    return len(os.sched_getaffinity(0))


class LocalWorkers:
    """Processes on this computer, started with the first work and ended with the block; one is this process itself.

    Raises UserError or VolcalError naming the item that failed, RunError when a process died.
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
            return _here(pickled, items, done)
        chunks = split_into_chunks(items, self.processes)
        try:
            return self._in_processes(pickled, chunks, done)
        except BrokenProcessPool:
            self._stop()
            hint = "was memory short? Take fewer --workers"
            raise RunError("a worker process died in the middle of its work", hint=hint) from None
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
        """End the processes at once, whatever they are doing, then the thread that led them: left to the interpreter's
        end, it closes a pipe that is being written to there."""
        if self._pool is None:
            return
        own = [child for child in multiprocessing.active_children() if child.pid not in self._others]
        for child in own:
            child.terminate()
        for child in own:
            child.join(END_S)
        self._pool.shutdown(cancel_futures=True)
        self._pool = None


def _here(task: bytes, items: Sequence[Item], done: OnItemsDone) -> list[Result]:
    """In this process, from the same pickled task as everywhere: an array may come out of it laid out otherwise."""
    found: list[Result] = []
    with threadpool_limits(limits=1):
        for number, item in enumerate(items):
            found += run_chunk(task, Chunk(number, [item]))
            done(len(found))
    return found


@contextmanager
def _without_interrupt() -> Iterator[None]:
    """Processes started inside never see the keyboard's interrupt: only this one decides what it means."""
    former = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, former)


def _end_with_parent() -> None:
    """A worker waits for work on a pipe that it holds open itself, so it would outlive a parent that was killed."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        threading.Thread(target=_exit_after, args=(parent.join,), daemon=True).start()


def _exit_after(wait: Callable[[], None]) -> None:
    wait()
    os._exit(1)
