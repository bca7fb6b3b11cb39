"""Work shared among processes: the same numbers for every distribution, and a clean end after every failure."""

from __future__ import annotations

import multiprocessing
import pickle
import signal
import sys
import threading
from collections.abc import Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from types import FrameType
from typing import Any

import numpy as np
import pytest
import study_tasks
from hypothesis import given
from hypothesis import strategies as st
from threadpoolctl import threadpool_limits  # type: ignore[import-untyped]

from agent.errors import RunError
from agent.studies.workers import LocalWorkers, generator, in_chunks, run_chunk
from drivers.errors import ConfigurationError, InputError, VolcalError


def ignore(_: int) -> None:
    """Ignore the progress."""


def sums() -> study_tasks.Sums:
    """Return a task whose matrix has a memory layout that unpickling never produces."""
    whole = np.random.default_rng(3).standard_normal((120, 120))
    return study_tasks.Sums(whole.T[::2, ::2], seed=11)


class TestChunks:
    @given(st.integers(0, 3000), st.integers(1, 80))
    def test_they_hold_every_item_once_and_in_order(self, count: int, workers: int) -> None:
        chunks: list[tuple[int, list[int]]] = []

        def run(first: int, items: Sequence[int]) -> list[int]:
            chunks.append((first, list(items)))
            return list(items)

        with ThreadPoolExecutor(1) as executor:
            assert in_chunks(executor, workers, run, range(count), ignore) == list(range(count))
        assert [item for _, items in chunks for item in items] == list(range(count))
        assert [first for first, _ in chunks] == [items[0] for _, items in chunks]
        assert all(len(items) <= 32 for _, items in chunks)
        assert len({len(items) for _, items in chunks[:-1]}) <= 1

    def test_a_failing_item_is_named_by_number_and_content(self) -> None:
        with pytest.raises(VolcalError, match=r"failed: TypeError: .*\(item 7: 'S3'\)"), threadpool_limits(limits=1):
            run_chunk(pickle.dumps(abs), 7, ["S3"])


class Recorded(ThreadPoolExecutor):
    """One thread, with a record of the futures that were returned."""

    def __init__(self) -> None:
        super().__init__(1)
        self.futures: list[Future[Any]] = []

    def submit(self, *work: Any, **named: Any) -> Future[Any]:
        future = super().submit(*work, **named)
        self.futures.append(future)
        return future


class TestKeyboardInterrupt:
    @pytest.mark.parametrize("entry", [1, 2, 3, 5, 8, 13, 21, 34, 55, 89, 144, 233])
    def test_it_leaves_no_future_locked(self, entry: int) -> None:
        """The keyboard interrupts when this thread takes a lock of the kind that every future has for the nth time."""
        entered = 0

        def interrupt(_: FrameType, event: str, called: Any) -> None:
            nonlocal entered
            if event == "c_call" and isinstance(getattr(called, "__self__", None), type(threading.RLock())):
                entered += 1
                if entered == entry:
                    signal.raise_signal(signal.SIGINT)

        executor = Recorded()
        start = threading.Event()
        executor.submit(start.wait)
        sys.setprofile(interrupt)
        try:
            in_chunks(executor, 80, lambda _, items: list(items), range(2000), lambda _: None, start.set, 0.0)
        except KeyboardInterrupt:
            interrupted = True
        else:
            interrupted = False
        finally:
            sys.setprofile(None)
            start.set()
        assert interrupted == (entered >= entry)
        reader = threading.Thread(target=lambda: [future.exception() for future in executor.futures], daemon=True)
        reader.start()
        reader.join(60.0)
        assert not reader.is_alive(), "a future is locked"
        executor.shutdown()


class TestGenerators:
    def test_every_item_has_its_own_and_keeps_it(self) -> None:
        drawn = {item: generator(1, item).standard_normal(3).tolist() for item in range(200)}
        assert len({tuple(values) for values in drawn.values()}) == 200
        assert generator(1, 17).standard_normal(3).tolist() == drawn[17]
        assert generator(2, 17).standard_normal(3).tolist() != drawn[17]
        assert generator(1, 17, 0).standard_normal(3).tolist() != drawn[17]


class TestLocalWorkers:
    def test_numbers_do_not_depend_on_how_many_there_are(self) -> None:
        alone = np.array(LocalWorkers(1).map(sums(), range(23), ignore))
        for processes in (2, 3):
            with LocalWorkers(processes) as workers:
                shared = np.array(workers.map(sums(), range(23), ignore))
                fewer = np.array(workers.map(sums(), range(9), ignore))
            assert shared.tobytes() == alone.tobytes()
            assert fewer.tobytes() == alone[:9].tobytes()

    def test_progress_grows_to_the_number_of_items(self) -> None:
        told: list[int] = []
        with LocalWorkers(2) as workers:
            assert workers.map(study_tasks.squared, range(40), told.append) == [n * n for n in range(40)]
        assert told == sorted(told)
        assert told[-1] == 40

    @pytest.mark.parametrize("processes", [1, 2])
    def test_no_work_at_all_is_no_error(self, processes: int) -> None:
        with LocalWorkers(processes) as workers:
            assert workers.map(study_tasks.squared, [], ignore) == []

    @pytest.mark.parametrize("processes", [1, 2])
    def test_a_failing_item_is_named_and_ends_the_work(self, processes: int) -> None:
        with LocalWorkers(processes) as workers:
            with pytest.raises(VolcalError, match=r"ZeroDivisionError: .* \(item 5\)") as failed:
                workers.map(study_tasks.undefined, range(12), ignore)
            assert failed.value.exit_code == 1
            with pytest.raises(InputError, match=r"nothing can be seen \(file set.csv, item 5\)\. measure more"):
                workers.map(study_tasks.unseen, range(12), ignore)
            assert workers.map(study_tasks.squared, range(3), ignore) == [0, 1, 4]
        assert multiprocessing.active_children() == []

    def test_a_process_that_dies_is_an_error_and_no_wait_without_end(self) -> None:
        with LocalWorkers(2) as workers:
            with pytest.raises(RunError, match="a worker process died"):
                workers.map(study_tasks.deadly, range(12), ignore)
            assert workers.map(study_tasks.squared, range(3), ignore) == [0, 1, 4]
        assert multiprocessing.active_children() == []

    def test_the_keyboard_ends_processes_in_the_middle_of_their_work(self) -> None:
        with LocalWorkers(2) as workers, pytest.raises(KeyboardInterrupt):
            workers.map(study_tasks.interrupting, range(4), ignore)
        assert multiprocessing.active_children() == []

    def test_no_worker_at_all_is_refused(self) -> None:
        with pytest.raises(ConfigurationError, match="at least one worker"):
            LocalWorkers(0)
