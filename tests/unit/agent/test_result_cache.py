"""A slow result of one run delays neither those of other runs nor a second computation of the same one."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from threading import Barrier, Event, Lock
from types import SimpleNamespace
from typing import Any

import pytest

from agent.service.page import result_cache
from agent.service.page.result_cache import MAX_COMPUTED_AT_ONCE, ResultCache, RunLocks

PATIENCE_S = 60.0
HERE = Path("state")


class SlowRuns:
    """Journal whose run `slow` is read only when `may_end` is set; `read` lists what was read."""

    def __init__(self, *, ended: bool = True) -> None:
        self.read: list[str] = []
        self.began, self.may_end = Event(), Event()
        self._ended = "2026-11-28T03:15:00Z" if ended else None

    def record(self, _: Path, run_id: str) -> Any:
        self.read.append(run_id)
        if run_id == "slow":
            self.began.set()
            assert self.may_end.wait(PATIENCE_S)
        return SimpleNamespace(run_id=run_id, ended=self._ended)

    def install(self, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr(result_cache, "read_record", self.record)
        monkeypatch.setattr(result_cache, "report_of", lambda record: SimpleNamespace(identification=record.run_id))
        monkeypatch.setattr(result_cache, "_curves", lambda _, identification: {"of": identification})


def test_a_slow_run_delays_only_those_who_ask_for_it(monkeypatch: pytest.MonkeyPatch) -> None:
    runs, cache = SlowRuns(), ResultCache()
    runs.install(monkeypatch)
    with ThreadPoolExecutor(3) as threads:
        waiting = [threads.submit(cache.curves, HERE, "slow") for _ in range(2)]
        assert runs.began.wait(PATIENCE_S)
        other = threads.submit(cache.curves, HERE, "quick")
        assert other.result(PATIENCE_S) == {"of": "quick"}
        assert not any(one.done() for one in waiting)
        runs.may_end.set()
        assert [one.result(PATIENCE_S) for one in waiting] == [{"of": "slow"}] * 2
    assert sorted(runs.read) == ["quick", "slow"], "each was computed once"
    assert len(cache.run_locks) == 0


def test_a_run_in_progress_is_computed_each_time(monkeypatch: pytest.MonkeyPatch) -> None:
    runs, cache = SlowRuns(ended=False), ResultCache()
    runs.install(monkeypatch)
    for _ in range(2):
        cache.curves(HERE, "now")
    assert runs.read == ["now", "now"]


def test_no_more_results_are_computed_at_once_than_permitted(monkeypatch: pytest.MonkeyPatch) -> None:
    cache, lock, inside, most = ResultCache(), Lock(), 0, 0
    together = Barrier(MAX_COMPUTED_AT_ONCE)

    def curves(_: object, identification: str) -> dict[str, str]:
        nonlocal inside, most
        with lock:
            inside += 1
            most = max(most, inside)
        together.wait(PATIENCE_S)
        with lock:
            inside -= 1
        return {"of": identification}

    SlowRuns().install(monkeypatch)
    monkeypatch.setattr(result_cache, "_curves", curves)
    run_ids = [f"r-{number}" for number in range(5 * MAX_COMPUTED_AT_ONCE)]
    with ThreadPoolExecutor(len(run_ids)) as threads:
        waiting = [threads.submit(cache.curves, HERE, run_id) for run_id in run_ids]
        assert [one.result(PATIENCE_S)["of"] for one in waiting] == run_ids
    assert most == MAX_COMPUTED_AT_ONCE


def test_an_error_frees_the_lock_of_its_run() -> None:
    locks = RunLocks()
    for _ in range(2):
        with pytest.raises(ZeroDivisionError), locks.locked(HERE, "r-1"), locks.locked(HERE, "r-2"):
            assert len(locks) == 2
            raise ZeroDivisionError
    assert len(locks) == 0
