"""Order of events in the engine, durability of the journal, and the behaviour of both on errors."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from agent.errors import Busy
from agent.execution.engine import Engine
from agent.execution.journal import Journal, RunJournal
from agent.execution.journal_reader import open_journal
from agent.execution.journal_schema import FILE_NAME
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
    seen: list[list[tuple[object, ...]]] = []  # through another connection: only what was committed

    def look(_: object) -> Touch:
        with open_journal(tmp_path) as reader:
            seen.append([(step.key, step.begun_s is not None, step.result_text) for step in reader.steps(1)])
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
    with open_journal(tmp_path) as reader:
        assert "connection reset" in str(reader.steps(1)[0].error)
        assert "station-1/park" in reader.events(1, ("fault",))[0].record_text


def test_balls_temperatures_and_decisions_have_their_tables(tmp_path: Path, run_journal: RunJournal) -> None:
    def plan() -> Plan[None]:
        yield ReadTemperatures("t")
        yield Record("ball-00/centre", "ball", {"centre_mm": np.array([1.0, 2.0, 3.0]), "ball": 0})
        yield Record("gate", "decision", {"passed": True})
        yield Record("ball-01/lost", "event", {"reason": "met nothing"})

    actions = {ReadTemperatures: lambda _: {"artefact": 20.25}, Record: lambda _: None}
    Engine(actions, run_journal).run(plan())
    with open_journal(tmp_path) as reader:
        assert [one.record for one in reader.temperatures(1)] == [{"artefact": 20.25}]
        assert [one.record["centre_mm"] for one in reader.balls(1)] == [[1.0, 2.0, 3.0]]
        assert [one.kind for one in reader.decisions(1)] == ["gate"]
        assert [one.kind for one in reader.events(1)] == ["event"]


def test_a_staged_table_is_stored_completely(tmp_path: Path, run_journal: RunJournal) -> None:
    counts = np.arange(24, dtype=np.int32).reshape(2, 2, 2, 3) - 7
    image = TableImage((0.0, 0.0, 0.0), (1.0, 1.0, 1.0), 1e-4, counts)

    def plan() -> Plan[None]:
        yield StageTable("publish/stage", 1, image)

    Engine({StageTable: lambda _: None}, run_journal).run(plan())
    run_journal.table("staged", 1, image)
    with open_journal(tmp_path) as reader:
        (table,) = reader.tables(1)
        stored = reader.image(table)
    assert stored is not None
    assert stored.same_as(image)
    assert np.array_equal(stored.counts, counts)


def test_the_balls_of_a_run_that_was_never_closed_are_stored(journal: Journal, tmp_path: Path) -> None:
    run = journal.start_run("run-2", "calibrate", {}, "0.1.0", VirtualClock())
    run.finish(Record("b/centre", "ball", {"ball": 3}), None, begun=False)
    with open_journal(tmp_path) as reader:
        assert [ball.record for ball in reader.balls(run.run)] == [{"ball": 3}]


def test_two_runs_cannot_share_an_identity(journal: Journal, run_journal: RunJournal) -> None:
    with pytest.raises(Busy, match="run-1 exists"):
        journal.start_run("run-1", "calibrate", {}, "0.1.0", VirtualClock())


def test_the_error_for_a_journal_that_cannot_be_opened_names_the_file(tmp_path: Path) -> None:
    (tmp_path / FILE_NAME).write_text("this is no database, " * 100)
    with pytest.raises(ConfigurationError, match="journal cannot be opened"):
        Journal(tmp_path)


def test_every_state_has_a_packml_name_and_a_successor_unless_final() -> None:
    assert set(PACKML) == set(RunState)
    for state in set(RunState) - FINAL:
        assert FORWARD[state]
        assert may_follow(state, RunState.FAULTED) or state is RunState.FAULTED
    assert not any(may_follow(state, RunState.IDLE) for state in FINAL)
