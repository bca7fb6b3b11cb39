"""Reader of the journal: rows of runs, whole or interrupted."""

from __future__ import annotations

import shutil
import sqlite3
from pathlib import Path

import numpy as np
import pytest

from agent.errors import JournalFailed
from agent.execution.journal import Journal
from agent.execution.journal_copy import copy_journal
from agent.execution.journal_reader import JournalReader, has_journal, open_journal
from agent.execution.journal_schema import FILE_NAME
from agent.execution.states import RunState
from agent.execution.steps import MoveTo, ReadTemperatures, Record, TouchTowards
from drivers.clock import VirtualClock
from drivers.errors import InputError
from drivers.roles import TableImage, Touch

FIRST, SECOND = "20261101T020000Z-0000", "20261102T020000Z-0000"
TABLE = TableImage((0.0, 0.0, 0.0), (1.0, 1.0, 1.0), 1e-4, np.arange(24, dtype=np.int32).reshape(2, 2, 2, 3))


@pytest.fixture
def state(tmp_path: Path) -> Path:
    """A complete run with a table, and one that was interrupted in its second step."""
    journal = Journal(tmp_path)
    clock = VirtualClock()
    first = journal.start_run(FIRST, "calibrate", {"secret": "hidden", "tool": "probe"}, "1.0", clock)
    touch = TouchTowards("ball-00/touch-0", (1.0, 2.0, 3.0), 5.0)
    clock.sleep(60.0)
    first.begin(touch)
    clock.sleep(30.0)
    first.finish(touch, Touch((1.0, 2.0, 2.5)), begun=True)
    first.aside().begin(MoveTo("recover/withdraw", (0.0, 0.0, 0.0)))
    clock.sleep(90.0)
    first.finish(ReadTemperatures("t"), {"artefact": 20.25}, begun=False)
    first.finish(Record("ball-00/centre", "ball", {"ball": 0}), None, begun=False)
    first.table("backup", 1, TABLE)
    first.table("staged", 2, None)
    first.aside().decision("restore/activated", {"bank": 1})
    first.decision("accepted", {"crc32": 7})
    first.state(RunState.COMPLETE, final=True)
    second = journal.start_run(SECOND, "verify", {"tool": "side"}, "1.0", clock)
    second.state(RunState.MEASURING)
    second.begin(MoveTo("station-1/park", (0.0, 0.0, 0.0)))
    journal.close()
    return tmp_path


def test_runs_are_listed_and_paged(state: Path) -> None:
    with open_journal(state) as reader:
        assert reader.run_ids() == (FIRST, SECOND)
        (latest,) = reader.run_counts(limit=1)
        (earlier,) = reader.run_counts(limit=5, before_run=latest.run.run)
        last = reader.last_run()
        assert reader.run("none") is None
        with pytest.raises(InputError, match=f"no run none.*the last ones are: {SECOND}, {FIRST}"):
            reader.require_run("none")
    assert latest.run == last
    assert (latest.run.run_id, latest.balls, latest.touches) == (SECOND, 0, 0)
    assert (earlier.run.run_id, earlier.balls, earlier.touches, earlier.run.state) == (FIRST, 1, 1, "complete")


def test_a_step_that_did_not_end_has_no_result(state: Path) -> None:
    with open_journal(state) as reader:
        (step,) = reader.steps(2)
        touch, _, _ = reader.steps(1)
        assert [one.key for one in reader.steps(1, procedure_only=True)] == ["ball-00/touch-0", "t"]
        assert reader.steps(1, "MoveTo")[0].key == "recover/withdraw"
        assert (reader.last_step_key(2), reader.count_steps(1), reader.last_ordinal(1)) == ("station-1/park", 3, 4)
    assert (step.finished_s, step.result, step.detail["target_mm"]) == (None, None, [0.0, 0.0, 0.0])
    assert (touch.begun_s, touch.finished_s, touch.result) == (60.0, 90.0, {"touch": [1.0, 2.0, 2.5]})


def test_temperatures_are_minutes_after_the_first_step(state: Path) -> None:
    with open_journal(state) as reader:
        (reading,) = reader.temperatures(1)
        assert reader.time_span_s(1) == (60.0, 180.0)
        assert reader.time_span_s(3) is None
    assert (reading.minutes, reading.record) == (2.0, {"artefact": 20.25})


def test_a_rejected_reading_is_a_step_with_its_reason_and_no_temperature_of_the_run(tmp_path: Path) -> None:
    journal = Journal(tmp_path)
    run = journal.start_run(FIRST, "calibrate", {}, "1.0", VirtualClock())
    for key, value in (("a/temperatures", 20.0), ("b/temperatures", 85.0), ("b/read-again-1/temperatures", 20.1)):
        run.finish(ReadTemperatures(key), {"artefact": value}, begun=False)
    rejected = {"rejected": "b/temperatures", "reason": "the artefact's temperature jumped"}
    run.finish(Record("b/rejected", "event", rejected), None, begun=False)
    journal.close()
    with open_journal(tmp_path) as reader:
        assert [one.record["artefact"] for one in reader.temperatures(1)] == [20.0, 20.1]
        assert [one.result for one in reader.steps(1, "ReadTemperatures")][1] == {"artefact": 85.0}
        assert [one.record for one in reader.events(1)] == [{"step": "b/rejected", **rejected}]


def test_events_and_decisions_by_kind_and_number(state: Path) -> None:
    with open_journal(state) as reader:
        (event,) = reader.events(2, ("state", "fault"))
        assert reader.events(2, after=event.number) == ()
        assert reader.events(2, ("fault",)) == ()
        assert reader.last_event_number(2, "state") == event.number
        assert reader.last_event_number(2, "fault") == 0
        assert [one.kind for one in reader.decisions(1)] == ["restore/activated", "accepted"]
        assert [one.kind for one in reader.decisions(1, procedure_only=True)] == ["accepted"]
        accepted = reader.last_decision("accepted")
        assert reader.last_decision("accepted", before_run=1) is None
        assert reader.has_decision(1, {"accepted", "table-restored"})
        assert not reader.has_decision(2, {"accepted"})
    assert event.record == {"state": "measuring", "reason": ""}
    assert accepted is not None
    assert (accepted.run_id, accepted.record) == (FIRST, {"crc32": 7})


def test_the_active_table_is_a_staged_one_only_if_it_was_accepted(state: Path) -> None:
    with open_journal(state) as reader:
        backup, staged = reader.tables(1)
        assert reader.last_active_table({"accepted"}) == staged
        assert reader.last_active_table({"table-restored"}) == backup
        assert reader.last_backup() == backup
        assert reader.last_backup(2) is None
        assert reader.last_table(1, "restored") is None
        assert reader.image(staged) is None
        image = reader.image(backup)
    assert image is not None
    assert image.same_as(TABLE)


def test_the_run_that_was_resumed_last_is_the_last_that_read_the_compensation(tmp_path: Path) -> None:
    journal, clock = Journal(tmp_path), VirtualClock()
    for number, run_id in enumerate((FIRST, SECOND), 1):
        run = journal.start_run(run_id, "calibrate", {}, "1.0", clock)
        run.state(RunState.PREFLIGHT)
        run.table("backup", number, None)
        run.state(RunState.FAULTED, final=True)
    with open_journal(tmp_path) as reader:
        assert [row.bank for row in (reader.last_backup(), reader.last_active_table(())) if row] == [2, 2]
    resumed = journal.continue_run(1, FIRST, clock)[0].aside()
    resumed.state(RunState.RESUMING)
    resumed.table("staged", 3, TABLE)
    with open_journal(tmp_path) as reader:
        assert [row.bank for row in (reader.last_backup(), reader.last_active_table(())) if row] == [1, 1]
    resumed.aside().table("restored", 1, None)
    resumed.decision("accepted", {"crc32": 7})
    journal.close()
    with open_journal(tmp_path) as reader:
        active = reader.last_active_table({"accepted"})
    assert active is not None
    assert active.bank == 3


def test_reading_creates_nothing_and_raises_the_error_of_the_caller(tmp_path: Path) -> None:
    assert not has_journal(tmp_path)
    for failure in (InputError, JournalFailed):
        with pytest.raises(failure, match="cannot be read"), open_journal(tmp_path, failure) as reader:
            reader.run_ids()
    assert not has_journal(tmp_path)
    (tmp_path / FILE_NAME).write_bytes(b"no database" * 100)
    with pytest.raises(JournalFailed, match="not a database"), open_journal(tmp_path, JournalFailed) as reader:
        reader.run_ids()


def test_any_connection_can_be_read(state: Path) -> None:
    journal = Journal(state)
    assert JournalReader(journal._connection).run_ids() == (FIRST, SECOND)
    journal.close()


def test_a_copy_has_the_edited_settings_alone(state: Path, tmp_path_factory: pytest.TempPathFactory) -> None:
    target = tmp_path_factory.mktemp("copy")
    path = copy_journal(state, target, lambda settings: {**settings, "secret": "removed"})
    with open_journal(target) as reader, open_journal(state) as original:
        assert reader.settings_text(1) == '{"secret": "removed", "tool": "probe"}'
        assert original.settings_text(1) == '{"secret":"hidden","tool":"probe"}'
        assert reader.steps(1) == original.steps(1)
    assert b"hidden" not in path.read_bytes()


def test_a_journal_whose_creation_was_interrupted_is_none_yet_and_the_next_run_creates_it(tmp_path: Path) -> None:
    begun, left = tmp_path / "begun", tmp_path / "left"
    begun.mkdir()
    connection = sqlite3.connect(begun / FILE_NAME, isolation_level=None)
    connection.executescript("PRAGMA cache_size = 1; BEGIN; CREATE TABLE wide (text); CREATE TABLE narrow (text)")
    connection.executemany("INSERT INTO wide VALUES (?)", [("x" * 5000,)] * 50)  # more than stays in memory
    shutil.copytree(begun, left)  # as the process leaves it that is killed now
    connection.close()
    assert (left / f"{FILE_NAME}-journal").exists()
    assert not has_journal(left)
    journal = Journal(left)
    journal.start_run(FIRST, "calibrate", {}, "1.0", VirtualClock())
    journal.close()
    with open_journal(left) as reader:
        assert reader.run_ids() == (FIRST,)
