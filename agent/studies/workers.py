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
from concurrent.futures import Executor, Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from functools import partial
from queue import Empty, SimpleQueue
from typing import Any, Protocol, Self, TypeVar

import numpy as np
from threadpoolctl import threadpool_limits  # type: ignore[import-untyped]

from agent.errors import RunError
from drivers.errors import ConfigurationError, InputError, VolcalError
from twin.errors import TwinError

Item = TypeVar("Item")
Result = TypeVar("Result")

OnItemsDone = Callable[[int], None]
"""Callback with the number of items done."""

RunItems = Callable[[int, Sequence[Item]], list[Result]]
"""Computation of the results of consecutive items, from the number of the first of them on."""

END_S = 5.0
"""Time to wait for a terminated process, in s."""

_MAX_NAME_LENGTH = 60
_CHUNKS_PER_WORKER = 8  # enough that all workers finish at about the same time
_MAX_ITEMS = 32  # items of a chunk, so that progress is visible; sending a task of 100 kB costs less than one item


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


def run_chunk(task: bytes, first: int, items: Sequence[Any]) -> list[Any]:
    """Return the results of a pickled task for consecutive items, of which the first has the number `first`. Raises
    VolcalError with the name of the item if the task fails for an item.

    Linear algebra in this process is limited to one thread, because the result of a sum computed by several threads
    depends on the number of threads.
    """
    function = pickle.loads(task)  # noqa: S301  pickled by the process that started this work
    threadpool_limits(limits=1)  # after unpickling, since it affects only libraries that are already loaded
    results = []
    for number, item in enumerate(items, start=first):
        try:
            results.append(function(item))
        except Exception as error:
            raise _as_volcal_error(error, _item_name(number, item)) from error
    return results


def in_chunks(
    executor: Executor,
    workers: int,
    run: RunItems[Item, Result],
    items: Sequence[Item],
    done: OnItemsDone,
    waited: Callable[[], None] | None = None,
    poll_s: float | None = None,
) -> list[Result]:
    """Return the results of `run` for all items, in their order. The executor runs it for chunks of items that keep
    all its `workers` busy; the last chunk may be shorter.

    `done` is called as results arrive, and `waited` each time that none has arrived for `poll_s` seconds.
    """
    size = max(1, min(_MAX_ITEMS, -(-len(items) // (_CHUNKS_PER_WORKER * workers))))
    # Not concurrent.futures.wait: it locks every pending future in turn, and a keyboard interrupt among these leaves
    # some locked for good. The thread of the executor would then wait for them for ever when the pool is shut down.
    ended: SimpleQueue[Future[list[Result]]] = SimpleQueue()
    with _interrupt_deferred():
        futures = [executor.submit(run, first, items[first : first + size]) for first in range(0, len(items), size)]
        for future in futures:
            future.add_done_callback(ended.put)
    pending, finished = len(futures), 0
    while pending:
        try:
            future = ended.get(timeout=poll_s)
        except Empty:
            if waited is not None:
                waited()
            continue
        pending -= 1
        finished += len(future.result())
        done(finished)
    return [result for future in futures for result in future.result()]


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
        # Pickled for this process too, because unpickling may change the memory layout of an array.
        run = partial(run_chunk, pickle.dumps(task))
        if self.processes == 1 or len(items) < 2:
            return _run_in_process(run, items, done)
        try:
            return in_chunks(self._started(), self.processes, run, items, done)
        except BrokenProcessPool:
            self._stop()
            hint = "if memory was short, use fewer --workers"
            raise RunError("a worker process died during its work", hint=hint) from None
        except BaseException:
            self._stop()
            raise

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


def _run_in_process(run: RunItems[Item, Result], items: Sequence[Item], done: OnItemsDone) -> list[Result]:
    found: list[Result] = []
    with threadpool_limits(limits=1):
        for number in range(len(items)):
            found += run(number, items[number : number + 1])
            done(len(found))
    return found


@contextmanager
def _interrupt_deferred() -> Iterator[None]:
    """Defer a keyboard interrupt to the end of the `with` block, and block it in processes started inside; only this
    process handles it.
    """
    interrupts: list[int] = []
    # A thread of a library may receive the signal although this thread blocks it, so the handler is replaced too.
    is_main = threading.current_thread() is threading.main_thread()
    former_mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    former = signal.signal(signal.SIGINT, lambda number, _: interrupts.append(number)) if is_main else None
    try:
        yield
    finally:
        if is_main:
            signal.signal(signal.SIGINT, former)
        signal.pthread_sigmask(signal.SIG_SETMASK, former_mask)
        if interrupts:
            signal.raise_signal(signal.SIGINT)


def _end_with_parent() -> None:
    """End this worker when its parent ends. The worker itself holds open the pipe on which it waits for work, so
    without this it would outlive a killed parent."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        threading.Thread(target=_exit_after, args=(parent.join,), daemon=True).start()


def _exit_after(wait: Callable[[], None]) -> None:
    wait()
    os._exit(1)


def _as_volcal_error(error: Exception, item: str) -> VolcalError:
    if isinstance(error, VolcalError):
        return error.at(item=item)
    if isinstance(error, TwinError):
        return InputError(error.message, hint=error.hint, **error.where).at(item=item)
    return VolcalError(f"the computation failed: {type(error).__name__}: {error}", item=item)


def _item_name(number: int, item: object) -> str:
    text = repr(item)
    return str(number) if text == str(number) or len(text) > _MAX_NAME_LENGTH else f"{number}: {text}"
