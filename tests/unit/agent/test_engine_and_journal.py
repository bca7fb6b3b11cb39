"""The engine's order of events, the journal's durability, and what both do when something goes wrong."""

from __future__ import annotations

import json
import sqlite3
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from agent.errors import Busy
from agent.execution.engine import Engine
from agent.execution.journal import FILE_NAME, Journal, RunJournal
from agent.execution.states import FINAL, FORWARD, PACKML, RunState, may_follow
from agent.execution.steps import (
    MoveTo,
    Plan,
    ReadActiveBank,
    ReadTemperatures,
    Record,
    StageTable,
    TouchTowards,
)
from drivers.clock import VirtualClock
from drivers.errors import ConfigurationError, LinkLost
from drivers.roles import TableImage, Touch

ORIGIN = (0.0, 0.0, 0.0)


@pytest.fixture
def journal(tmp_path: Path) -> Iterator[Journal]:
    journal = Journal(tmp_path)
    yield journal
    journal.close()


@pytest.fixture
def run_journal(journal: Journal) -> RunJournal:
    return journal.start_run("run-1", "calibrate", {"machine": "m.toml"}, "0.1.0", VirtualClock())


def rows(path: Path, query: str) -> list[tuple[object, ...]]:
    """What another process sees: only what was committed."""
    with sqlite3.connect(path / FILE_NAME) as other:
        found = other.execute(query).fetchall()
    other.close()
    return found


def test_results_are_sent_back_and_the_conclusion_returned() -> None:
    def plan() -> Plan[int]:
        first = yield ReadActiveBank("a")
        second = yield ReadActiveBank("b")
        return first * 10 + second

    answers = iter([4, 2])
    assert Engine({ReadActiveBank: lambda _: next(answers)}).run(plan()) == 42


def test_a_step_is_durable_before_it_moves_and_its_result_before_the_next(
    tmp_path: Path, run_journal: RunJournal
) -> None:
    seen: list[list[tuple[object, ...]]] = []

    def look(_: object) -> Touch:
        seen.append(rows(tmp_path, "SELECT key, begun IS NOT NULL, result FROM steps ORDER BY ordinal"))
        return Touch((1.0, 2.0, 0.1 + 0.2))

    def plan() -> Plan[None]:
        yield TouchTowards("ball-00/touch-0", ORIGIN, 5.0)
        yield TouchTowards("ball-00/touch-1", ORIGIN, 5.0)

    Engine({TouchTowards: look}, run_journal).run(plan())
    assert seen[0] == [("ball-00/touch-0", 1, None)]
    assert seen[1][0][:2] == ("ball-00/touch-0", 1)
    assert json.loads(str(seen[1][0][2])) == {"touch": [1.0, 2.0, 0.30000000000000004]}
    assert len(seen[1]) == 2


def test_an_error_names_its_step_and_is_in_the_journal(tmp_path: Path, run_journal: RunJournal) -> None:
    def lose(_: object) -> None:
        raise LinkLost("connection reset", link="tcp:host:502")

    closed = []

    def plan() -> Plan[None]:
        try:
            yield MoveTo("station-1/park", ORIGIN)
        finally:
            closed.append(True)

    with pytest.raises(LinkLost) as caught:
        Engine({MoveTo: lose}, run_journal).run(plan())
    assert caught.value.where == {"link": "tcp:host:502", "step": "station-1/park"}
    assert closed == [True]
    assert "connection reset" in str(rows(tmp_path, "SELECT error FROM steps")[0][0])
    assert "station-1/park" in str(rows(tmp_path, "SELECT record FROM events WHERE kind = 'fault'")[0][0])


def test_balls_temperatures_and_decisions_have_their_tables(tmp_path: Path, run_journal: RunJournal) -> None:
    def plan() -> Plan[None]:
        yield ReadTemperatures("t")
        yield Record("ball-00/centre", "ball", {"centre_mm": np.array([1.0, 2.0, 3.0]), "ball": 0})
        yield Record("gate", "decision", {"passed": True})
        yield Record("ball-01/lost", "event", {"reason": "met nothing"})

    actions = {ReadTemperatures: lambda _: {"artefact": 20.25}, Record: lambda _: None}
    Engine(actions, run_journal).run(plan())
    assert json.loads(str(rows(tmp_path, "SELECT record FROM temperatures")[0][0])) == {"artefact": 20.25}
    assert json.loads(str(rows(tmp_path, "SELECT record FROM balls")[0][0]))["centre_mm"] == [1.0, 2.0, 3.0]
    assert rows(tmp_path, "SELECT kind FROM decisions") == [("gate",)]
    assert rows(tmp_path, "SELECT kind FROM events") == [("event",)]


def test_a_staged_table_is_kept_whole(tmp_path: Path, run_journal: RunJournal) -> None:
    counts = np.arange(24, dtype=np.int32).reshape(2, 2, 2, 3) - 7
    image = TableImage((0.0, 0.0, 0.0), (1.0, 1.0, 1.0), 1e-4, counts)

    def plan() -> Plan[None]:
        yield StageTable("publish/stage", 1, image)

    Engine({StageTable: lambda _: None}, run_journal).run(plan())
    run_journal.table("staged", 1, image)
    ((blob,),) = rows(tmp_path, "SELECT counts FROM tables")
    assert isinstance(blob, bytes)
    assert np.array_equal(np.frombuffer(blob, ">i4").reshape(2, 2, 2, 3), counts)


def test_a_run_keeps_its_balls_when_nobody_closes_it(journal: Journal, tmp_path: Path) -> None:
    run = journal.start_run("run-2", "calibrate", {}, "0.1.0", VirtualClock())
    run.finish(Record("b/centre", "ball", {"ball": 3}), None, begun=False)
    reopened = Journal(tmp_path)
    assert reopened.read_balls("run-2") == [{"ball": 3}]
    reopened.close()


def test_two_runs_cannot_share_an_identity(journal: Journal, run_journal: RunJournal) -> None:
    with pytest.raises(Busy, match="run-1 exists"):
        journal.start_run("run-1", "calibrate", {}, "0.1.0", VirtualClock())


def test_a_journal_that_cannot_be_opened_says_where(tmp_path: Path) -> None:
    (tmp_path / FILE_NAME).write_text("this is no database, " * 100)
    with pytest.raises(ConfigurationError, match="journal cannot be opened"):
        Journal(tmp_path)


def test_every_state_has_a_packml_name_and_a_way_out() -> None:
    assert set(PACKML) == set(RunState)
    for state in set(RunState) - FINAL:
        assert FORWARD[state]
        assert may_follow(state, RunState.FAULTED) or state is RunState.FAULTED
    assert not any(may_follow(state, RunState.IDLE) for state in FINAL)
